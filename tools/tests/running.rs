//! The tool beside a running program: it looks at the network that the program shows.
#![allow(missing_docs)]

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::{Child, Command, Output, Stdio},
    time::Duration,
};

use servocrab::{DriveConfig, Network, drives, link::Wire};
use servocrab_attach::{Attach, Attached, serve};
use servocrab_sim::{Segment, personality};
use tempfile::TempDir;

/// A machine with the axes `x` and `y`, shown as that of the interface `sim0`.
struct Program {
    directory: TempDir,
    attached: Option<Attached>,
    net: Network,
}

impl Program {
    fn start() -> Self {
        let mut segment = Segment::new().with(personality::akd2g());
        let wire = Wire::new(move |frame, now| segment.process(frame, now));
        let drive = DriveConfig::new(drives::akd2g()).axis("x").axis("y");
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
        }
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
fn the_panel_of_a_running_program_is_shown_with_a_token_and_what_it_grants() {
    let program = Program::start();
    let mut panel = Running(
        program
            .tool("panel --interface sim0")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut line = String::new();
    BufReader::new(panel.0.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    let (address, token) = line
        .trim()
        .strip_prefix("http://")
        .unwrap()
        .split_once("/#token=")
        .unwrap();
    let get = |path: &str, token: &str| {
        let mut stream = TcpStream::connect(address).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(10)))
            .unwrap();
        write!(
            stream,
            "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nAuthorization: Bearer {token}\r\n\r\n"
        )
        .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    };
    let axes = get("/v1/axes", token);
    assert!(
        axes.starts_with("HTTP/1.1 200") && axes.contains("\"name\":\"y\""),
        "{axes}"
    );
    assert!(
        get("/v1/grants", token).contains("\"parameters\":false"),
        "the program grants nothing"
    );
    assert!(get("/v1/axes", "0").starts_with("HTTP/1.1 401"));
    drop(panel);
    program.end();
}
