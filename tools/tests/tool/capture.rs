//! What is taken from a line over a veth pair: its frames beside a program, and a bundle of a line that no program shows.

use std::{
    env,
    fs::{self, File},
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    time::Duration,
};

use crate::{
    bundle,
    namespace::{Process, inside_namespace, run, say, simulated},
};
use pcap_file::pcapng::{
    Block, PcapNgReader,
    blocks::{
        enhanced_packet::EnhancedPacketOption, interface_description::InterfaceDescriptionOption,
    },
};
use serde_json::Value;
use servocrab::{DriveConfig, Network, drives, parameters::ParameterSet};

const TOOL: &str = env!("CARGO_BIN_EXE_servocrab");

/// Where no program shows anything.
fn command(runtime: &Path, arguments: &str) -> Command {
    let mut command = Command::new(TOOL);
    command.args(arguments.split_whitespace());
    command.env("XDG_RUNTIME_DIR", runtime).stdin(Stdio::null());
    command
}

fn ended(output: Output) -> (Option<i32>, String, String) {
    let text = |bytes| String::from_utf8(bytes).expect("text");
    (
        output.status.code(),
        text(output.stdout),
        text(output.stderr),
    )
}

/// The simulator of this workspace, as built with the tests.
fn simulator() -> PathBuf {
    let path = Path::new(TOOL).with_file_name("servocrab-sim");
    let missing = "it is not built: run `cargo test --workspace`";
    assert!(path.exists(), "{}: {missing}", path.display());
    path
}

/// A program that moves nothing.
fn program() -> Network {
    let builder = Network::builder()
        .interface("master0")
        .cycle(Duration::from_millis(2))
        .watchdog(Duration::from_secs(5))
        .drive(0, DriveConfig::new(drives::akd2g()).axis("x"));
    smol::block_on(builder.start()).unwrap()
}

/// How many frames of a capture were sent and received.
fn directions(file: &Path) -> (usize, usize) {
    let mut reader = PcapNgReader::new(File::open(file).unwrap()).unwrap();
    let (mut sent, mut received, mut interfaces) = (0, 0, 0);
    while let Some(block) = reader.next_block() {
        match block.unwrap() {
            Block::InterfaceDescription(interface) => {
                use InterfaceDescriptionOption::{IfName, IfTsResol};
                let expected = [IfName("master0".into()), IfTsResol(9)];
                assert_eq!(interface.options, expected);
                interfaces += 1;
            }
            Block::EnhancedPacket(packet) => {
                assert_eq!(packet.data.get(12..14), Some(&[0x88, 0xA4][..]));
                assert_eq!(packet.original_len as usize, packet.data.len());
                // From 1970 on, and not from the start of the computer.
                assert!(packet.timestamp > Duration::from_secs(1_600_000_000));
                match packet.options.first() {
                    Some(EnhancedPacketOption::Flags(1)) => received += 1,
                    Some(EnhancedPacketOption::Flags(2)) => sent += 1,
                    other => panic!("{other:?}"),
                }
            }
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(interfaces, 1);
    (sent, received)
}

/// How many EtherCAT frames tshark sees; none where it is not installed.
fn seen_by_tshark(file: &Path) -> Option<usize> {
    let tshark = Command::new("tshark")
        .args([
            "-n",
            "-Y",
            "ecat",
            "-T",
            "fields",
            "-e",
            "frame.protocols",
            "-r",
        ])
        .arg(file)
        .output();
    let Ok(tshark) = tshark else {
        let message = "SKIPPED: tshark is not installed";
        let is_ci = env::var("CI").as_deref() == Ok("true");
        assert!(!is_ci, "{message}, and in CI that is a failure");
        say(message);
        return None;
    };
    let (code, output, errors) = ended(tshark);
    assert_eq!(code, Some(0), "{errors}");
    let mut lines = output.lines();
    assert!(
        lines.all(|line| line.starts_with("eth:ethertype:ecatf:ecat")),
        "{output}"
    );
    Some(output.lines().count())
}

#[test]
fn the_frames_of_a_running_program_are_captured_in_both_directions() {
    if !inside_namespace("capture::the_frames_of_a_running_program_are_captured_in_both_directions")
    {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("frames.pcapng");
    let tool = |arguments: &str| {
        let arguments = format!("{arguments} --pcapng {}", file.display());
        command(directory.path(), &arguments)
    };
    let _line = simulated(&simulator(), &["akd2g"], 120, None);
    let net = program();

    let captured = tool("--json capture --interface master0 --frames 200").output();
    let (code, output, errors) = ended(captured.unwrap());
    assert_eq!(code, Some(0), "{errors}");
    let said: Value = serde_json::from_str(&output).unwrap();
    assert_eq!(said["frames"], 200);
    let (sent, received) = directions(&file);
    assert_eq!(sent + received, 200);
    assert!(
        sent > 50 && received > 50,
        "{sent} sent, {received} received"
    );
    assert_eq!(
        (said["sent"].as_u64(), said["received"].as_u64()),
        (Some(sent as u64), Some(received as u64))
    );
    assert!(seen_by_tshark(&file).is_none_or(|seen| seen == 200));

    // Ctrl-C ends it in order.
    let mut capture = Process(
        tool("capture --interface master0")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut line = String::new();
    let mut says = BufReader::new(capture.0.stderr.take().unwrap());
    says.read_line(&mut line).unwrap();
    assert!(line.contains("listening on master0"), "{line}");
    let begun = net.statistics().cycles;
    while net.statistics().cycles < begun + 50 {
        std::thread::yield_now();
    }
    run("kill", &["-INT", &capture.0.id().to_string()]);
    let mut text = String::new();
    let mut output = capture.0.stdout.take().unwrap();
    output.read_to_string(&mut text).unwrap();
    assert_eq!(capture.0.wait().unwrap().code(), Some(0));
    let (sent, received) = directions(&file);
    assert!(sent >= 50, "{sent} sent");
    let counted = format!("{} frames in {}", sent + received, file.display());
    assert!(text.starts_with(&counted), "{text}");

    // The program has not noticed it.
    assert_eq!(net.statistics().foreign, 0);
    smol::block_on(net.shutdown()).unwrap();

    // On a line where nothing is sent it ends by its time.
    let (code, output, errors) =
        ended(tool("capture --interface slave0 --for 1").output().unwrap());
    assert_eq!(code, Some(0), "{errors}");
    assert!(output.starts_with("0 frames in "), "{output}");
}

#[test]
fn a_capture_that_cannot_begin_says_what_to_do() {
    if !inside_namespace("capture::a_capture_that_cannot_begin_says_what_to_do") {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("frames.pcapng");
    let capture = |interface: &str| {
        format!(
            "capture --interface {interface} --pcapng {}",
            file.display()
        )
    };
    let refused = |command: &mut Command| {
        let (code, _, errors) = ended(command.output().unwrap());
        assert_eq!(code, Some(2), "{errors}");
        errors
    };
    let errors = refused(&mut command(directory.path(), &capture("nowhere0")));
    assert!(
        errors.contains("there is no network interface `nowhere0`"),
        "{errors}"
    );
    run("ip", &["link", "set", "master0", "down"]);
    let errors = refused(&mut command(directory.path(), &capture("master0")));
    assert!(errors.contains("ip link set master0 up"), "{errors}");
    run("ip", &["link", "set", "master0", "up"]);
    // Without the right to open raw sockets.
    let mut without = Command::new("setpriv");
    without.args(["--bounding-set", "-net_raw", TOOL]);
    without.args(capture("master0").split_whitespace());
    let errors = refused(&mut without);
    assert!(errors.contains("setcap cap_net_raw+ep"), "{errors}");
    assert!(!file.exists());
}

#[test]
fn a_bundle_of_a_line_without_a_program_has_its_scan_and_its_parameters() {
    if !inside_namespace(
        "capture::a_bundle_of_a_line_without_a_program_has_its_scan_and_its_parameters",
    ) {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("bundle.zip");
    let bundle = || {
        let arguments = format!("bundle --interface master0 --yes --out {}", file.display());
        let (code, output, errors) = ended(command(directory.path(), &arguments).output().unwrap());
        assert_eq!(code, Some(0), "{output}{errors}");
        (bundle::parts(&file), output)
    };
    let line = simulated(&simulator(), &["coupler", "akd2g", "generic"], 120, None);
    let (whole, said) = bundle();
    let names: Vec<_> = whole.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "doctor.json",
            "parameters/1.toml",
            "parameters/2.toml",
            "scan.json",
            "versions.json"
        ]
    );
    assert!(said.contains("5 parts in "), "{said}");
    let scan: Value = serde_json::from_str(&whole["scan.json"]).unwrap();
    assert_eq!(scan[1]["name"], "AKD2G");
    let doctor: Value = serde_json::from_str(&whole["doctor.json"]).unwrap();
    let mut checks = doctor.as_array().unwrap().iter();
    assert!(checks.any(|check| check["check"] == "raw socket" && check["verdict"] == "good"));
    for name in ["parameters/1.toml", "parameters/2.toml"] {
        let set = ParameterSet::from_toml(&whole[name], name).unwrap();
        assert!(set.parameters.len() > 10, "{name}");
    }
    drop(line);

    // Another program has the line, and shows nothing of it: the rest is written, in place of the file before.
    let _line = simulated(&simulator(), &["akd2g"], 120, None);
    let net = program();
    let (rest, said) = bundle();
    let names: Vec<_> = rest.keys().map(String::as_str).collect();
    assert_eq!(names, ["doctor.json", "missing.txt", "versions.json"]);
    let missing = &rest["missing.txt"];
    assert!(
        missing.starts_with("scan.json") && missing.contains("is in use"),
        "{missing}"
    );
    assert!(said.contains(missing.trim_end()), "{said}");
    smol::block_on(net.shutdown()).unwrap();
    // Nothing half written is left.
    let left = fs::read_dir(directory.path()).unwrap();
    assert_eq!(left.count(), 1);
}
