//! The tool beside a running program: it looks at the network that the program shows.

use crate::{bundle, panel, python};
use std::{
    env, fs,
    io::Write,
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use serde_json::Value;
use servocrab::{DriveConfig, Network, bus::NetworkEvent, drives, link::Wire};
use servocrab_attach::{Attach, Attached, serve};
use servocrab_sim::{Segment, personality};
use tempfile::TempDir;

/// A machine with the axes `x` and `y`, shown as that of the interface `sim0`.
struct Program {
    directory: TempDir,
    attached: Option<Attached>,
    net: Network,
    /// No frame comes back.
    is_cut: Arc<AtomicBool>,
}

impl Program {
    fn start() -> Self {
        Self::with_axes(["x", "y"])
    }

    fn with_axes([first, second]: [&str; 2]) -> Self {
        let mut segment = Segment::new().with(personality::akd2g());
        let is_cut = Arc::new(AtomicBool::new(false));
        let cut = Arc::clone(&is_cut);
        let wire = Wire::new(move |frame: &mut [u8], now| {
            segment.process(frame, now) && !cut.load(Ordering::Relaxed)
        });
        let drive = DriveConfig::new(drives::akd2g()).axis(first).axis(second);
        let builder = Network::builder()
            .link(wire)
            .cycle(Duration::from_millis(2))
            .watchdog(Duration::from_secs(5))
            .drive(0, drive);
        let net = smol::block_on(builder.start()).unwrap();
        let directory = tempfile::tempdir().unwrap();
        let attach = Attach::new("sim0").directory(directory.path().join("servocrab"));
        let attached = Some(serve(&net, attach).unwrap());
        Self {
            directory,
            attached,
            net,
            is_cut,
        }
    }

    /// A file beside the socket.
    fn place(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    fn tool(&self, arguments: &str) -> Command {
        let mut tool = Command::new(env!("CARGO_BIN_EXE_servocrab"));
        tool.args(arguments.split_whitespace())
            .env("XDG_RUNTIME_DIR", self.directory.path())
            .stdin(Stdio::null());
        tool
    }

    fn run(&self, arguments: &str) -> (Option<i32>, String, String) {
        let Output {
            status,
            stdout,
            stderr,
        } = self.tool(arguments).output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (status.code(), text(stdout), text(stderr))
    }

    fn end(mut self) {
        self.attached.take();
        smol::block_on(self.net.shutdown()).unwrap();
    }
}

/// Ends with its test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_cycles_of_a_running_program_are_watched_and_none_is_missing() {
    let program = Program::start();
    let (code, output, errors) =
        program.run("watch --interface sim0 --for 1 x.position x.state lateness");
    assert_eq!((code, errors.as_str()), (Some(0), ""), "{output}");
    let mut lines = output.lines();
    assert_eq!(
        lines.next(),
        Some("cycle,time [s],x.position [counts],x.state,lateness [µs]")
    );
    let rows: Vec<Vec<f64>> = lines
        .map(|line| {
            line.split(',')
                .map(|value| value.parse().unwrap())
                .collect()
        })
        .collect();
    assert!(rows.len() > 50, "{} rows", rows.len());
    assert!(rows.windows(2).all(|rows| rows[1][0] == rows[0][0] + 1.0));
    assert!(
        rows.iter().all(|row| row[2].abs() < 100.0 && row[3] == 1.0),
        "Switch on disabled"
    );

    // A trigger ends it, with the cycles around it.
    let mut trigger =
        program.tool("--json watch --interface sim0 --before 2 --after 3 x.state --trigger");
    let trigger = trigger
        .arg("x.position > 0")
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let shown = trigger.wait_with_output().unwrap();
    assert!(shown.status.success());
    let shown = String::from_utf8(shown.stdout).unwrap();
    assert!(
        shown.lines().count() <= 6 && shown.contains("\"values\":[1.0]"),
        "{shown}"
    );

    let (code, _, errors) = program.run("watch --interface sim0 --for 1 z.position");
    assert_eq!(code, Some(2));
    assert!(
        errors.contains("no axis is named `z`") && errors.contains("`x`, `y`"),
        "{errors}"
    );
    program.end();
}

#[test]
fn the_name_of_an_axis_with_quotes_is_one_field_of_the_heading() {
    let program = Program::with_axes(["x", "\"left\""]);
    let (code, output, errors) =
        program.run("watch --interface sim0 --for 1 x.position \"left\".position");
    assert_eq!((code, errors.as_str()), (Some(0), ""), "{output}");
    let heading = "cycle,time [s],x.position [counts],\"\"\"left\"\".position [counts]\"";
    assert_eq!(output.lines().next(), Some(heading));
    program.end();
}

#[test]
fn the_panel_of_a_running_program_is_shown_with_a_token_and_what_it_grants() {
    let program = Program::start();
    let mut panel = Running(
        program
            .tool("panel --interface sim0")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let (address, token) = panel::address(&mut panel.0);
    let get = |path: &str, token: &str| panel::get(&address, token, path);
    let axes = get("/v1/axes", &token);
    assert!(
        axes.starts_with("HTTP/1.1 200") && axes.contains("\"name\":\"y\""),
        "{axes}"
    );
    assert!(
        get("/v1/grants", &token).contains("\"parameters\":false"),
        "the program grants nothing"
    );
    assert!(get("/v1/axes", "0").starts_with("HTTP/1.1 401"));
    drop(panel);
    program.end();
}

#[test]
fn the_panel_of_a_line_shows_terminals_too_unless_drives_alone_are_wanted() {
    for (more, state) in [("", "OP"), (" --drives-only", "PREOP")] {
        let directory = tempfile::tempdir().unwrap();
        let arguments = format!("panel --sim akd2g,io --watchdog-ms 5000{more}");
        let mut panel = Running(
            Command::new(env!("CARGO_BIN_EXE_servocrab"))
                .args(arguments.split(' '))
                .env("XDG_RUNTIME_DIR", directory.path())
                .stdout(Stdio::piped())
                .spawn()
                .unwrap(),
        );
        let (address, token) = panel::address(&mut panel.0);
        let answer = panel::get(&address, &token, "/v1/devices");
        let (_, body) = answer.split_once("\r\n\r\n").unwrap();
        let devices: Value = serde_json::from_str(body).unwrap();
        let states = [&devices[0]["state"], &devices[1]["state"]];
        assert_eq!(states, ["OP", state], "{arguments}");
    }
}

/// What the index and the messages of an MCAP file have. A file that was not completed has no index.
fn messages(file: &Path) -> Vec<Value> {
    let bytes = fs::read(file).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().expect("an index");
    let messages: Vec<Value> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| serde_json::from_slice(&message.unwrap().data).unwrap())
        .collect();
    let counted = summary.stats.expect("statistics").message_count;
    assert_eq!(counted, messages.len() as u64);
    let numbers: Vec<_> = messages
        .iter()
        .map(|m| m["cycle"].as_u64().unwrap())
        .collect();
    assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1));
    messages
}

/// What the public reader finds in an MCAP file; none where its environment cannot be made.
fn read_by_python(file: &Path) -> Option<Value> {
    let test = env::current_exe().unwrap();
    let target = test.ancestors().nth(3).expect("target/PROFILE/deps/TEST");
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/mcap");
    let requirements = sources.join("requirements.txt");
    let python = python::environment(&target.join("tools/mcap"), &requirements, "mcap.reader");
    let python = match python {
        Ok(python) => python,
        Err(error) => {
            let message = format!("SKIPPED: the public reader of MCAP cannot be had here: {error}");
            let is_ci = env::var("CI").as_deref() == Ok("true");
            assert!(!is_ci, "{message}; in CI that is a failure");
            let _ = writeln!(std::io::stderr(), "{message}");
            return None;
        }
    };
    let mut reader = Command::new(python);
    let read = reader.arg(sources.join("read.py")).arg(file).output();
    let read = read.unwrap();
    let errors = String::from_utf8_lossy(&read.stderr);
    assert!(read.status.success(), "{errors}");
    Some(serde_json::from_slice(&read.stdout).unwrap())
}

#[test]
fn the_cycles_of_a_running_program_become_an_mcap_file_and_a_picture_that_others_open() {
    let program = Program::start();
    let (file, picture) = (program.place("run.mcap"), program.place("run.svg"));
    let (code, output, errors) = program.run(&format!(
        "--json watch --interface sim0 --for 1 x.position x.state lateness --mcap {} --svg {}",
        file.display(),
        picture.display()
    ));
    assert_eq!((code, errors.as_str()), (Some(0), ""), "{output}");
    let said: Value = serde_json::from_str(&output).unwrap();
    let messages = messages(&file);
    assert!(messages.len() > 50, "{} messages", messages.len());
    assert_eq!(said["cycles"].as_u64(), Some(messages.len() as u64));
    assert_eq!(said["lost"], 0);
    assert!(messages.iter().all(|message| message["x.state"] == 1.0));
    let picture = fs::read_to_string(picture).unwrap();
    for text in ["x.position", "counts", "x.state", "lateness", "µs"] {
        assert!(picture.contains(text), "{text}");
    }

    if let Some(read) = read_by_python(&file) {
        assert_eq!(read["count"].as_u64(), Some(messages.len() as u64));
        let found = read["messages"].as_array().unwrap();
        assert_eq!(found.len(), messages.len());
        for (found, message) in found.iter().zip(&messages) {
            assert_eq!(found["data"], *message);
            assert_eq!(found["topic"], "/servocrab");
            assert_eq!(
                (&found["schema"], &found["encoding"]),
                (&"jsonschema".into(), &"json".into())
            );
            assert_eq!(found["log_time"], found["publish_time"]);
            assert_eq!(found["properties"]["x.position"]["description"], "counts");
        }
        let times: Vec<_> = found
            .iter()
            .map(|m| m["log_time"].as_u64().unwrap())
            .collect();
        assert!(
            times.windows(2).all(|pair| pair[0] < pair[1]),
            "nanoseconds"
        );
    }

    // With a trigger the cycles around it alone.
    let mut trigger = program.tool("watch --interface sim0 --before 2 --after 3 x.state --mcap");
    trigger.arg(&file).args(["--trigger", "x.position > 0"]);
    assert!(trigger.output().unwrap().status.success());
    let messages = self::messages(&file);
    assert!((1..=6).contains(&messages.len()), "{messages:?}");
    assert!(
        messages
            .iter()
            .all(|message| message["x.position"].is_null())
    );
    program.end();
}

#[test]
fn a_recording_that_is_interrupted_is_complete() {
    let program = Program::start();
    let file = program.place("run.mcap");
    let arguments = format!(
        "watch --interface sim0 x.position --mcap {}",
        file.display()
    );
    let mut watch = Running(
        program
            .tool(&arguments)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    // The schema is far shorter: by then there are messages.
    while fs::metadata(&file).map_or(0, |file| file.len()) < 4096 {
        assert!(watch.0.try_wait().unwrap().is_none(), "it has ended");
        std::thread::yield_now();
    }
    let process = watch.0.id().to_string();
    let interrupted = Command::new("kill").args(["-INT", &process]).status();
    assert!(interrupted.unwrap().success());
    assert_eq!(watch.0.wait().unwrap().code(), Some(0));
    assert!(!messages(&file).is_empty());
    let (code, _, errors) =
        program.run("watch --interface sim0 --for 1 x.position --mcap /nowhere/x");
    assert_eq!(code, Some(2));
    assert!(errors.contains("/nowhere/x: "), "{errors}");
    program.end();
}

/// It does not try to open the line, which the program has.
#[test]
fn a_panel_says_that_its_port_is_taken() {
    let program = Program::start();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let (status, _, said) = program.run(&format!("panel --interface sim0 --port {port}"));
    assert_eq!(status, Some(2), "{said}");
    assert!(said.contains(&format!("127.0.0.1:{port}")), "{said}");
}

#[test]
fn a_bundle_has_what_a_running_program_shows_and_the_objects_of_its_drives() {
    let program = Program::start();
    // A loss, which leaves a black box.
    program.is_cut.store(true, Ordering::Relaxed);
    let view = program.net.view();
    let has_box = |(_, event): &(u64, NetworkEvent)| matches!(event, NetworkEvent::AxisIncident(_));
    while !view.recent_events().iter().any(has_box) {
        std::thread::yield_now();
    }
    program.is_cut.store(false, Ordering::Relaxed);
    let log = program.place("machine.log");
    fs::write(&log, "it was loud\n").unwrap();
    let file = program.place("bundle.zip");
    let (code, output, errors) = program.run(&format!(
        "--json bundle --interface sim0 --out {} --log {} --log /nowhere.log",
        file.display(),
        log.display()
    ));
    assert_eq!(code, Some(0), "{output}{errors}");
    let said: Value = serde_json::from_str(&output).unwrap();
    let parts = bundle::parts(&file);
    let names: Vec<_> = parts.keys().map(String::as_str).collect();
    assert_eq!(said["parts"].as_array().unwrap().len(), names.len());
    let json = |name: &str| -> Value { serde_json::from_str(&parts[name]).unwrap() };
    assert_eq!(
        json("versions.json")["servocrab"],
        env!("CARGO_PKG_VERSION")
    );
    assert!(json("doctor.json").as_array().unwrap().len() > 3);
    assert_eq!(json("line.json")["drives"][0]["name"], "AKD2G");
    assert_eq!(json("axes.json")[1]["name"], "y");
    for name in ["statistics.json", "events.json", "grants.json", "ios.json"] {
        assert!(names.contains(&name), "{names:?}");
    }
    assert!(parts["metrics.txt"].contains("servocrab_cycles_total"));
    let black_box = names.iter().find(|name| name.starts_with("black_box/"));
    let black_box = json(black_box.expect("a black box"));
    assert!(!black_box["cycles"].as_array().unwrap().is_empty());
    let objects = json("od/0.json");
    let mut objects = objects.as_array().unwrap().iter();
    let statusword = objects.find(|object| object["index"] == 0x6041).unwrap();
    assert_eq!(statusword["bytes"].as_array().unwrap().len(), 2);
    assert_eq!(parts["logs/machine.log"], "it was loud\n");
    assert!(!names.contains(&"scan.json"), "the line is the program's");
    let missing = &parts["missing.txt"];
    assert!(
        missing.starts_with("logs/nowhere.log: ") && missing.lines().count() == 1,
        "{missing}"
    );

    let again = format!("bundle --interface sim0 --out {}", file.display());
    let (code, _, errors) = program.run(&again);
    assert_eq!(code, Some(2));
    assert!(errors.contains("is there already"), "{errors}");
    program.end();
}
