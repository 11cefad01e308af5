//! The tool beside a program that moves: `pick_and_place` on one end of a veth pair, simulated drives on the other.

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use crate::{
    namespace::{Process, inside_namespace, run, say, simulated_on},
    panel,
};
use serde_json::Value;
use tempfile::TempDir;

const TOOL: &str = env!("CARGO_BIN_EXE_servocrab");

/// A program of the workspace, as built with the tests.
fn program(name: &str) -> PathBuf {
    let path = Path::new(TOOL).with_file_name(name);
    assert!(
        path.exists(),
        "{} is not built: run `cargo test --workspace`",
        path.display()
    );
    path
}

/// `pick_and_place`, with its drives.
struct Machine {
    runtime: TempDir,
    program: Process,
    _line: Process,
}

impl Machine {
    /// Returns once it has placed its first part.
    fn start() -> Self {
        run("ip", &["link", "set", "lo", "up"]);
        let shaft = ["--stands-at", "300000", "--limit-switches", "0..100000000"];
        let shaft = shaft.map(str::to_owned);
        let line = simulated_on(
            "slave0",
            &program("servocrab-sim"),
            &["akd2g", "io"],
            120,
            &shaft,
        );
        let runtime = tempfile::tempdir().unwrap();
        let mut child = Command::new(program("examples/pick_and_place"))
            .args(["--interface", "master0"])
            .env("XDG_RUNTIME_DIR", runtime.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = BufReader::new(child.stdout.take().unwrap());
        let program = Process(child);
        let mut line_of_text = String::new();
        while !line_of_text.starts_with("placed a part") {
            line_of_text.clear();
            let read = said.read_line(&mut line_of_text).unwrap();
            assert!(read > 0, "it has ended");
        }
        // It goes on whether somebody reads or not.
        drop(said);
        Self {
            runtime,
            program,
            _line: line,
        }
    }

    fn tool(&self, arguments: &str) -> Command {
        let mut tool = Command::new(TOOL);
        tool.args(arguments.split_whitespace())
            .args(["--interface", "master0"])
            .env("XDG_RUNTIME_DIR", self.runtime.path())
            .stdin(Stdio::null());
        tool
    }

    /// Runs the tool to an end with this exit code; its output and its errors.
    fn run(&self, code: i32, arguments: &str) -> (String, String) {
        let output = self.tool(arguments).output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        let (said, errors) = (text(output.stdout), text(output.stderr));
        assert_eq!(
            output.status.code(),
            Some(code),
            "{arguments}: {said}{errors}"
        );
        (said, errors)
    }

    fn json(&self, arguments: &str) -> Value {
        let (said, _) = self.run(0, &format!("--json {arguments}"));
        serde_json::from_str(&said).unwrap()
    }

    /// It has moved on through it all, and ends in order.
    fn end(mut self) {
        let motions = self.json_of("/v1/statistics")["axes"][0]["motions"].clone();
        assert!(motions["reached"].as_u64() > Some(0), "{motions}");
        for end in ["fault", "lost", "missed", "failed", "unknown"] {
            assert_eq!(motions[end], Value::Null, "{motions}");
        }
        assert!(self.program.0.try_wait().unwrap().is_none(), "it runs");
        run("kill", &["-TERM", &self.program.0.id().to_string()]);
        assert!(self.program.0.wait().unwrap().success());
    }

    /// What the program says of itself on its socket.
    fn json_of(&self, path: &str) -> Value {
        let socket = self.runtime.path().join("servocrab/master0.sock");
        let program = servocrab_attach::Program::open(&socket).unwrap();
        let answer = smol::block_on(program.get(path)).unwrap();
        serde_json::from_slice(&answer).unwrap()
    }
}

#[test]
fn objects_and_parameters_are_read_beside_a_program_that_moves() {
    if !inside_namespace("live::objects_and_parameters_are_read_beside_a_program_that_moves") {
        return;
    }
    let machine = Machine::start();
    let scanned = machine.json("scan");
    assert_eq!(scanned[0]["name"], "AKD2G");
    assert_eq!(
        (&scanned[0]["axes"], &scanned[0]["alias"]),
        (&2.into(), &Value::Null)
    );
    // What the mailbox says is what the process data say.
    let mode = &machine.json("od read 6061h 6861h")[1];
    assert_eq!(mode["meaning"]["text"], "profile position mode (1)");
    let (listed, notes) = machine.run(0, "od list --filter 6041h");
    assert!(listed.contains("statusword"), "{listed}");
    assert!(notes.contains("nothing is reset"), "{notes}");

    // Nothing is written that the program does not grant.
    let (_, refused) = machine.run(2, "od write 6081h 1");
    assert!(refused.contains("does not grant"), "{refused}");
    let file = machine.runtime.path().join("drive.toml");
    machine.run(0, &format!("params backup {}", file.display()));
    let backup = fs::read_to_string(&file).unwrap();
    assert!(backup.contains("[identity]"), "{backup}");
    // But for what the program itself writes from move to move.
    let compared = machine.tool("params compare").arg(&file).output().unwrap();
    let compared = String::from_utf8(compared.stdout).unwrap();
    let differ = |line: &&str| line.contains("h:") && !line.starts_with("608");
    assert_eq!(compared.lines().find(differ), None, "{compared}");
    assert!(
        compared.contains("608") || compared.contains("agree"),
        "{compared}"
    );

    // It moves on meanwhile.
    let (watched, _) = machine.run(0, "watch --for 2 x.position y.position");
    let positions: Vec<f64> = watched
        .lines()
        .skip(1)
        .filter_map(|line| line.split(',').nth(2)?.parse().ok()) // a lost cycle has none
        .collect();
    let (least, most) = positions
        .iter()
        .fold((f64::MAX, f64::MIN), |(least, most), at| {
            (least.min(*at), most.max(*at))
        });
    assert!(most - least > 20.0, "{least} to {most} mm");
    machine.end();
}

/// Prometheus, of the system's own programs, beside the panel of the tool.
#[test]
fn prometheus_scrapes_a_program_that_moves_and_answers_a_query() {
    if Command::new("prometheus")
        .arg("--version")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_err()
    {
        let message = "prometheus_scrapes_…: SKIPPED: there is no `prometheus` here";
        assert_ne!(
            std::env::var("CI").as_deref(),
            Ok("true"),
            "{message}, and in CI that is a failure"
        );
        say(message);
        return;
    }
    if !inside_namespace("live::prometheus_scrapes_a_program_that_moves_and_answers_a_query") {
        return;
    }
    let machine = Machine::start();
    let mut panel = Process(
        machine
            .tool("panel")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let (address, token) = panel::address(&mut panel.0);
    // As docs/attach.md has it.
    let config = format!(
        "scrape_configs:\n  - job_name: machine\n    scrape_interval: 200ms\n    scrape_timeout: 200ms\n    \
         authorization: {{credentials: {token}}}\n    static_configs: [{{targets: [\"{address}\"]}}]\n"
    );
    let directory = machine.runtime.path();
    let file = directory.join("prometheus.yml");
    fs::write(&file, config).unwrap();
    let log = fs::File::create(directory.join("prometheus.log")).unwrap();
    let _prometheus = Process(
        Command::new("prometheus")
            .arg(format!("--config.file={}", file.display()))
            .arg(format!(
                "--storage.tsdb.path={}",
                directory.join("data").display()
            ))
            .arg("--web.listen-address=127.0.0.1:19090")
            .stderr(log)
            .spawn()
            .unwrap(),
    );
    let query = "sum(servocrab_axis_motions_total{end=\"reached\",axis=\"x\"})>3";
    let end = Instant::now() + Duration::from_secs(60);
    let found = loop {
        match answer(query) {
            Some(found) if found["data"]["result"][0]["value"][1].is_string() => break found,
            last => assert!(Instant::now() < end, "nothing in 60 s: {last:?}"),
        }
        std::thread::yield_now();
    };
    assert_eq!(found["status"], "success");
    for metric in [
        "servocrab_cycles_total",
        "servocrab_lateness_seconds",
        "servocrab_port_errors_total",
        "servocrab_axis_state",
    ] {
        let answer = answer(metric).unwrap();
        let result = &answer["data"]["result"];
        assert!(!result.as_array().unwrap().is_empty(), "{metric}: {answer}");
    }
    drop(panel);
    machine.end();
}

/// What Prometheus answers to this query; none before it listens.
fn answer(query: &str) -> Option<Value> {
    let escaped: String = query
        .bytes()
        .map(|byte| match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'_' => char::from(byte).to_string(),
            _ => format!("%{byte:02X}"),
        })
        .collect();
    let mut stream = TcpStream::connect("127.0.0.1:19090").ok()?;
    write!(
        stream,
        "GET /api/v1/query?query={escaped} HTTP/1.0\r\nHost: localhost\r\n\r\n"
    )
    .ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    let (_, body) = answer.split_once("\r\n\r\n")?;
    serde_json::from_str(body).ok()
}
