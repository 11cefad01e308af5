//! The program `servocrab-sim` from outside: what it prints, how it ends.

use std::process::{Command, Output};

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_servocrab-sim"))
        .args(arguments)
        .output()
        .unwrap()
}

fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Whether it got no raw socket: without the right to one, or where the loopback interface is not up.
fn has_no_raw_socket(output: &Output) -> bool {
    if output.status.success() {
        return false;
    }
    let errors = errors(output);
    assert!(
        errors.contains("CAP_NET_RAW") || errors.contains("is down"),
        "{errors}"
    );
    assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{errors}");
    true
}

#[test]
fn an_interface_that_is_not_there_ends_it_with_its_name() {
    let output = run(&["--interface", "nosuchif0", "--drive", "akd2g"]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(
        errors(&output),
        "servocrab-sim: there is no network interface \"nosuchif0\"\n"
    );
    assert!(output.stdout.is_empty());
}

#[test]
fn a_segment_without_devices_and_unknown_devices_are_refused() {
    assert_eq!(run(&["--interface", "lo"]).status.code(), Some(2));
    let output = run(&["--interface", "lo", "--drive", "akd9"]);
    assert_eq!(output.status.code(), Some(2));
    for known in ["akd2g", "pp2010", "ax2000", "sigma7", "generic"] {
        assert!(errors(&output).contains(known), "{}", errors(&output));
    }
}

#[test]
fn an_esi_file_makes_a_device_and_one_that_cannot_be_used_is_named_with_its_line() {
    let output = run(&["--interface", "lo", "--esi", "no/such.xml"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(errors(&output).starts_with("servocrab-sim: no/such.xml: "));
    let broken = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("broken.xml");
    std::fs::write(&broken, "<EtherCATInfo>\n<Vendor>\n</EtherCATInfo>").unwrap();
    let broken = broken.to_str().unwrap();
    let output = run(&["--interface", "lo", "--esi", broken]);
    let expected = format!("servocrab-sim: {broken}:3: ");
    assert!(
        errors(&output).starts_with(&expected),
        "{}",
        errors(&output)
    );
    // The file is read before the interface is opened.
    let sample = concat!(env!("CARGO_MANIFEST_DIR"), "/esi/akd2g.xml");
    let output = run(&[
        "--interface",
        "nosuchif0",
        "--drive",
        "coupler",
        "--esi",
        sample,
    ]);
    assert_eq!(
        errors(&output),
        "servocrab-sim: there is no network interface \"nosuchif0\"\n"
    );
}

#[test]
fn devices_of_files_are_chosen_by_product_and_stand_in_the_order_of_the_arguments() {
    let sample =
        |name: &str, rest: &str| format!("{}/esi/{name}{rest}", env!("CARGO_MANIFEST_DIR"));
    let other = sample("generic.xml", ":0x7:2h");
    let output = run(&["--interface", "lo", "--esi", &other]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        errors(&output).contains(
            "there is no device of product 00000007h and revision 00000002h; the file has 44530402h:00000001h"
        ),
        "{}",
        errors(&output)
    );
    let two_axes = sample("two_axes.xml", ":802h:1");
    let generic = sample("generic.xml", "");
    let output = run(&[
        "--interface",
        "lo",
        "--esi",
        &two_axes,
        "--drive",
        "coupler",
        "--esi",
        &generic,
        "--drive",
        "io",
        "--for",
        "0.01",
    ]);
    if has_no_raw_socket(&output) {
        return;
    }
    let text = String::from_utf8_lossy(&output.stdout);
    let line: Vec<_> = text.lines().skip(1).take(4).collect();
    assert!(
        line[0].starts_with("0: Modular drive with two axes") && line[0].ends_with("axes: 2"),
        "{text}"
    );
    assert!(line[1].starts_with("1: Coupler"), "{text}");
    assert!(line[2].starts_with("2: CiA 402 servo drive"), "{text}");
    assert!(
        line[3].starts_with("3: ") && line[3].ends_with("axes: 0"),
        "{text}"
    );
}

#[test]
fn it_runs_for_the_time_asked_for_and_traces_without_frames_or_says_what_right_it_lacks() {
    let trace = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("program-trace.csv");
    let path = trace.to_str().unwrap();
    let output = run(&[
        "--interface",
        "lo",
        "--drive",
        "coupler",
        "--drive",
        "akd2g",
        "--for",
        "0.3",
        "--trace",
        path,
    ]);
    if has_no_raw_socket(&output) {
        return;
    }
    assert_eq!(
        String::from_utf8_lossy(&output.stdout),
        "listening on lo: 2 SubDevice(s)\n\
         0: Coupler, vendor 00000000h, product 434F5550h, revision 1, serial 0, axes: 0\n\
         1: AKD2G EtherCAT Drive (CoE), vendor 0000006Ah, product 414B4432h, revision 1, serial 0, axes: 2\n\
         0: 0 accesses to the SII, 0 messages\n\
         1: 0 accesses to the SII, 0 messages\n"
    );
    let text = std::fs::read_to_string(trace).unwrap();
    assert!(text.starts_with(
        "time_s,drive,axis,al_state,controlword,statusword,target,position,velocity\n"
    ));
    // Two axes, a row each millisecond for 0.3 s.
    assert!(text.lines().count() > 400, "{} lines", text.lines().count());
}

#[test]
fn faults_that_are_not_known_or_do_not_fit_the_line_are_refused_with_what_is_known() {
    let with = |faults| {
        run(&[
            "--interface",
            "nosuchif0",
            "--drive",
            "generic",
            "--faults",
            faults,
            "--seed",
            "7",
        ])
    };
    let output = with("los=1%");
    assert_eq!(output.status.code(), Some(2));
    for known in ["there is no fault \"los\"", "loss", "delay", "cut", "plant"] {
        assert!(errors(&output).contains(known), "{}", errors(&output));
    }
    let output = with("loss=1%,cut=2s@1");
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(
        errors(&output),
        "servocrab-sim: there is no SubDevice 1: the line has 1, counted from 0\n"
    );
    // With faults that fit it comes as far as the interface.
    let output = with("loss=1%,delay=200us,cut=2s@0,plant=seeded");
    assert!(errors(&output).contains("nosuchif0"), "{}", errors(&output));
}

#[test]
fn aliases_and_cables_that_are_wrong_are_refused_with_an_example_or_with_the_devices_that_there_are()
 {
    let with = |option, value| {
        run(&[
            "--interface",
            "nosuchif0",
            "--drive",
            "generic",
            option,
            value,
        ])
    };
    for (option, example) in [("--alias", "1=7"), ("--unplug", "1@2..4.5")] {
        let output = with(option, "nonsense");
        assert_eq!(output.status.code(), Some(2));
        assert!(errors(&output).contains(example), "{}", errors(&output));
        let output = with(option, example);
        assert_eq!(output.status.code(), Some(1));
        assert_eq!(
            errors(&output),
            "servocrab-sim: there is no SubDevice 1: the line has 1, counted from 0\n"
        );
    }
    // Those that fit come as far as the interface.
    for (option, value) in [("--alias", "0=7"), ("--unplug", "0@2..4.5")] {
        let output = with(option, value);
        assert!(errors(&output).contains("nosuchif0"), "{}", errors(&output));
    }
}
