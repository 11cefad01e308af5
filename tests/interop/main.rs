//! Masters that nobody here wrote, on the simulated drives: each runs as a process of its own over a veth pair.
//!
//! What is checked is in `soem/` and `etherage/`, what each drive should answer in `drives.json`. A test fails unless every check of its
//! list was reported, in order and with success.
#![allow(missing_docs)]
#![cfg(target_os = "linux")]

#[path = "../common/namespace.rs"]
mod namespace;
mod programs;
#[path = "../common/python.rs"]
mod python;
mod tools;

use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, ExitStatus, Stdio},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use namespace::{Process, inside_namespace, simulated, simulated_with};

/// Seconds after which the simulated segment ends by itself, and with it whatever waits for its answers.
const LONGEST: u32 = 120;

/// How long etherage may try again when it gave up.
const PATIENCE: Duration = Duration::from_secs(30);

/// The checks of `soem/`, in order.
const SOEM: [&str; 31] = [
    "default_mapping",
    "scan",
    "sii_strings",
    "identity_by_sdo",
    "expedited",
    "segmented",
    "complete_access",
    "object_list",
    "aborts",
    "mapping_refusals",
    "remapping",
    "clock",
    "al_refusals",
    "watchdog_on",
    "safe_op",
    "operational",
    "cyclic",
    "enable",
    "profile_move",
    "second_set_point",
    "at_once",
    "relative_move",
    "halt",
    "quick_stop",
    "profile_velocity",
    "homing",
    "watchdog",
    "emergency",
    "recovery",
    "fault_reset",
    "back_to_init",
];

/// The checks of `soem/line.py`, in order.
const LINE: [&str; 4] = ["line_scan", "line_map", "line_clock", "line_operational"];

/// The checks of `soem/transfers.py`, in order.
const TRANSFERS: [&str; 4] = ["scan", "all_sizes", "complete_sizes", "pinned_messages"];

/// The checks of `etherage/`, in order.
const ETHERAGE: [&str; 17] = [
    "scan",
    "sii",
    "expedited",
    "normal",
    "complete_access",
    "aborts",
    "mapping",
    "clock",
    "safe_op",
    "operational",
    "cyclic",
    "enable",
    "profile_move",
    "watchdog",
    "recovery",
    "fault_reset",
    "back_to_init",
];

/// What etherage 0.5.1 itself cannot do, and why.
const NOT_BY_ETHERAGE: [(&str, &str); 5] = [
    (
        "segmented",
        "it takes the last-segment bit for its opposite and each segment for all of the rest; its first segment is sized for \
         a mailbox of 1024 bytes without its own headers",
    ),
    ("object_list", "SDO information is not implemented in it"),
    (
        "emergency",
        "it takes an emergency for the answer to its SDO, and every later answer for the one before",
    ),
    (
        "slow machines",
        "it gives a frame up after 100 ms and may panic when its answer comes later",
    ),
    (
        "working counters",
        "an exchange of its groups does not tell the counter",
    ),
];

/// Each test has two processes that talk in milliseconds: the tests run one at a time.
static TURN: Mutex<()> = Mutex::new(());

fn turn() -> MutexGuard<'static, ()> {
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs SOEM on a drive, in a namespace of its own.
fn soem(test: &str, drive: &str) {
    let dictionary = programs::dictionary(drive);
    run_soem(test, drive, "main.py", &[drive], &[], &[&dictionary], &SOEM);
}

/// Runs one of the Python programs on a line of devices: with options of the simulator, and with further arguments of its own.
fn run_soem(
    test: &str,
    name: &str,
    program: &str,
    devices: &[&str],
    options: &[String],
    arguments: &[&Path],
    checks: &[&str],
) {
    let Some(python) = programs::python() else {
        return;
    };
    let simulator = programs::simulator();
    let _turn = turn();
    if !inside_namespace(test) {
        return;
    }
    let _simulator = simulated_with(&simulator, devices, LONGEST, options);
    let mut command = Command::new(python);
    // Its parts import each other; nothing is to be left beside the sources.
    command
        .arg("-B")
        .arg(programs::sources().join("soem").join(program))
        .arg("master0")
        .arg(programs::table())
        .args(devices)
        .args(arguments);
    Run::of("soem", name, command).judge(checks);
}

/// Runs etherage on a drive, in a namespace of its own.
fn etherage(test: &str, drive: &str) {
    let Some(program) = programs::etherage() else {
        return;
    };
    let simulator = programs::simulator();
    let _turn = turn();
    if !inside_namespace(test) {
        return;
    }
    // etherage gives every frame 100 ms, which cannot be changed, and fails or panics when an answer comes later. Where it gave
    // up, and the drive was not found wrong, it runs again, on a drive just switched on.
    let begun = Instant::now();
    loop {
        let _simulator = simulated(&simulator, &[drive], LONGEST, None);
        let mut command = Command::new(&program);
        command.arg("master0").arg(programs::table()).arg(drive);
        let run = Run::of("etherage", drive, command);
        if run.passes(&ETHERAGE) || !run.gave_up() || begun.elapsed() > PATIENCE {
            run.judge(&ETHERAGE);
            break;
        }
        println!("etherage on {drive}: it gave up, once more");
    }
    for (step, reason) in NOT_BY_ETHERAGE {
        println!("etherage on {drive}: not done {step}: {reason}");
    }
}

/// What one program said, and how it ended.
struct Run {
    name: String,
    lines: Vec<String>,
    status: ExitStatus,
}

impl Run {
    /// Runs a program to its end and passes on what it says, line by line.
    fn of(master: &str, drive: &str, mut command: Command) -> Self {
        let mut process = command
            .stdout(Stdio::piped())
            .spawn()
            .map(Process)
            .expect("the program starts");
        let output = BufReader::new(process.0.stdout.take().expect("piped"));
        let mut lines = Vec::new();
        for line in output.lines() {
            let line = line.expect("text");
            println!("{master} on {drive}: {line}");
            lines.push(line);
        }
        let status = process.0.wait().expect("it is our child");
        programs::report(&format!("{master}-{drive}"), &lines);
        Self {
            name: format!("{master} on {drive}"),
            lines,
            status,
        }
    }

    /// The checks that were passed.
    fn passed(&self) -> Vec<&str> {
        self.lines
            .iter()
            .filter_map(|line| line.strip_prefix("ok ")?.split(':').next())
            .collect()
    }

    fn passes(&self, checks: &[&str]) -> bool {
        self.passed() == checks && self.status.success()
    }

    /// The master itself gave up; the drive was not found wrong.
    fn gave_up(&self) -> bool {
        self.status.code() == Some(2)
    }

    /// Holds it against the list of checks.
    fn judge(&self, checks: &[&str]) {
        assert_eq!(self.passed(), checks, "{}, {}", self.name, self.status);
        assert!(self.status.success(), "{}: {}", self.name, self.status);
    }
}

#[test]
fn soem_on_a_line_of_devices() {
    let devices = ["coupler", "akd2g", "io", "generic", "sigma7"];
    run_soem(
        "soem_on_a_line_of_devices",
        "line",
        "line.py",
        &devices,
        &[],
        &[],
        &LINE,
    );
}

/// Runs SOEM's transfers through mailboxes of this many bytes.
fn transfers(test: &str, drive: &str, mailbox: u16) {
    let session = programs::sources().join("../vectors/sdo_session.txt");
    let options = ["--mailbox-bytes".to_owned(), mailbox.to_string()];
    run_soem(
        test,
        &format!("transfers-{mailbox}"),
        "transfers.py",
        &[drive],
        &options,
        &[&session],
        &TRANSFERS,
    );
}

macro_rules! through {
    ($($test:ident: $drive:literal $mailbox:literal;)+) => {
        $(
            #[test]
            fn $test() {
                transfers(stringify!($test), $drive, $mailbox);
            }
        )+
    };
}

through! {
    soem_through_mailboxes_of_24_bytes: "generic" 24;
    soem_through_mailboxes_of_32_bytes: "generic" 32;
    soem_through_mailboxes_of_48_bytes: "sigma7" 48;
    soem_through_mailboxes_of_128_bytes: "generic" 128;
    soem_through_mailboxes_of_256_bytes: "generic" 256;
    soem_through_mailboxes_of_1024_bytes: "akd2g" 1024;
}

/// A test for each master on a drive of the table.
macro_rules! on {
    ($($drive:literal: $soem:ident $etherage:ident;)+) => {
        $(
            #[test]
            fn $soem() {
                soem(stringify!($soem), $drive);
            }

            #[test]
            fn $etherage() {
                etherage(stringify!($etherage), $drive);
            }
        )+
    };
}

on! {
    "akd2g": soem_on_akd2g etherage_on_akd2g;
    "pp2010": soem_on_pp2010 etherage_on_pp2010;
    "ax2000": soem_on_ax2000 etherage_on_ax2000;
    "sigma7": soem_on_sigma7 etherage_on_sigma7;
    "generic": soem_on_generic etherage_on_generic;
}
