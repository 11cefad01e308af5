//! Real time for the bus thread, as the system shows it: what was asked for is there, what is refused says what to change.
//!
//! Each test runs in a process of its own, so that locked memory and limits are nobody else's.

use std::{
    env, fs,
    process::{Command, Output},
};

use crate::namespace::assert_one_ran;
use servocrab::{
    DriveConfig, Network, NetworkError,
    bus::{RealTime, RealTimeError, Scheduling},
    drives,
    link::Wire,
};
use servocrab_sim::{Segment, personality};

const INSIDE: &str = "SERVOCRAB_TEST_REAL_TIME";

/// Runs the named test again in a process of its own, by this command; none if this process is that one.
fn in_a_process(test: &str, command: &[&str]) -> Option<Output> {
    if env::var_os(INSIDE).is_some() {
        return None;
    }
    let own = env::current_exe().expect("this test has a path");
    let mut arguments = command
        .iter()
        .map(std::convert::AsRef::as_ref)
        .chain([own.as_os_str()]);
    let test = format!("real_time::{test}");
    let mut child = Command::new(arguments.next().expect("itself at least"));
    let output = child
        .args(arguments)
        .args(["--exact", &test, "--nocapture", "--test-threads=1"])
        .env(INSIDE, "1")
        .output()
        .expect("it starts");
    print!("{}", String::from_utf8_lossy(&output.stdout));
    eprint!("{}", String::from_utf8_lossy(&output.stderr));
    if output.status.success() {
        assert_one_ran(&test, &output.stdout);
    }
    Some(output)
}

fn start(real_time: RealTime) -> Result<Network, NetworkError> {
    let mut segment = Segment::new().with(personality::generic());
    let builder = Network::builder()
        .link(Wire::new(move |frame: &mut [u8], now| {
            segment.process(frame, now)
        }))
        .drive(0, DriveConfig::new(drives::generic()).axis("x"))
        .real_time(real_time);
    smol::block_on(builder.start())
}

/// What the system shows of the thread with this name: processors, priority, policy (proc(5): `stat`, fields 40 and 41; `status`).
fn thread(name: &str) -> (String, u32, u32) {
    for task in fs::read_dir("/proc/self/task").expect("Linux").flatten() {
        let read = |name| fs::read_to_string(task.path().join(name)).unwrap_or_default();
        // The kernel cuts names after 15 bytes.
        if read("comm").trim() != name {
            continue;
        }
        let stat = read("stat");
        // The second field, the name in brackets, may hold spaces.
        let fields: Vec<&str> = stat
            .rsplit(')')
            .next()
            .unwrap_or("")
            .split_whitespace()
            .collect();
        let status = read("status");
        let processors = status
            .lines()
            .find_map(|line| line.strip_prefix("Cpus_allowed_list:"))
            .expect("a line with the processors");
        let number = |field: usize| fields[field - 3].parse().expect("a number");
        return (processors.trim().to_owned(), number(40), number(41));
    }
    panic!("no thread {name}");
}

fn locked_bytes() -> u64 {
    let status = fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find_map(|line| line.strip_prefix("VmLck:"));
    let number = line.and_then(|line| line.split_whitespace().next());
    number
        .expect("VmLck in kB")
        .parse::<u64>()
        .expect("a number")
        * 1024
}

#[test]
fn a_bus_thread_has_what_was_asked_for_or_the_network_does_not_start() {
    let name = "a_bus_thread_has_what_was_asked_for_or_the_network_does_not_start";
    if let Some(output) = in_a_process(name, &[]) {
        assert!(output.status.success());
        return;
    }
    let asked = RealTime::new()
        .scheduling(Scheduling::Fifo(7))
        .processors([0])
        .lock_memory();
    match start(asked) {
        Ok(network) => {
            let bus = thread("servocrab-bus");
            assert_eq!(bus, ("0".into(), 7, 1), "SCHED_FIFO is 1");
            let (_, priority, policy) = thread("servocrab-log");
            assert_eq!((priority, policy), (0, 0), "the log is for later");
            assert!(locked_bytes() > 100_000, "{}", locked_bytes());
            smol::block_on(network.shutdown()).unwrap();
        }
        Err(NetworkError::RealTime(error)) => {
            // A user without the rights; the next test looks at the errors.
            assert_ne!(env::var("CI").as_deref(), Ok("true"), "{error}");
            println!("not allowed here: {error}");
        }
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn the_log_of_a_network_that_a_real_time_thread_starts_has_no_real_time() {
    let name = "the_log_of_a_network_that_a_real_time_thread_starts_has_no_real_time";
    if let Some(output) = in_a_process(name, &[]) {
        assert!(output.status.success());
        return;
    }
    if let Err(error) = RealTime::new().scheduling(Scheduling::Fifo(7)).apply() {
        assert_ne!(env::var("CI").as_deref(), Ok("true"), "{error}");
        println!("not allowed here: {error}");
        return;
    }
    let network = start(RealTime::new()).unwrap();
    let (_, priority, policy) = thread("servocrab-bus");
    assert_eq!((priority, policy), (7, 1), "as its starter");
    let (_, priority, policy) = thread("servocrab-log");
    assert_eq!((priority, policy), (0, 0), "not as its starter");
    smol::block_on(network.shutdown()).unwrap();
}

#[test]
fn what_is_refused_ends_the_start_with_the_reason_and_the_remedy() {
    let name = "what_is_refused_ends_the_start_with_the_reason_and_the_remedy";
    // A user namespace of its own: no rights outside it.
    let command = ["unshare", "-r", "prlimit", "--rtprio=0", "--memlock=65536"];
    if let Some(output) = in_a_process(name, &command) {
        let shown = String::from_utf8_lossy(&output.stderr);
        if shown.contains("unshare") {
            assert_ne!(env::var("CI").as_deref(), Ok("true"), "{shown}");
            eprintln!("{name}: SKIPPED: no user namespace can be made here");
            return;
        }
        assert!(output.status.success());
        return;
    }
    let refused = |asked| match start(asked) {
        Err(NetworkError::RealTime(error)) => error,
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("it was allowed"),
    };
    let error = refused(RealTime::new().scheduling(Scheduling::RoundRobin(80)));
    assert!(
        matches!(&error, RealTimeError::Scheduling { source, .. } if source.raw_os_error() == Some(1)),
        "{error:?}"
    );
    let text = error.to_string();
    assert!(
        text.starts_with("the bus thread cannot run as SCHED_RR 80: "),
        "{text}"
    );
    let error = refused(RealTime::new().lock_memory());
    assert!(
        matches!(error, RealTimeError::MemoryLimit { limit: 65536 }),
        "{error:?}"
    );
    assert_eq!(locked_bytes(), 0, "nothing was locked");
    let error = refused(RealTime::new().processors([0, 1 << 20]));
    assert!(
        matches!(error, RealTimeError::NoProcessor { asked, .. } if asked == 1 << 20),
        "{error:?}"
    );
}
