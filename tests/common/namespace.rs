//! A network of one's own for a test: a namespace with a veth pair, and the simulated segment's process on one end.
//!
//! Where no namespace can be made the test says so and passes, but fails when `CI=true`.

use std::{
    env,
    io::{self, BufRead, BufReader, Write},
    path::Path,
    process::{Child, Command, Stdio},
};

/// Set in the environment of a test that runs inside its namespace.
pub(crate) const INSIDE: &str = "SERVOCRAB_TEST_NAMESPACE";

/// Runs the named test again inside a namespace with a veth pair; true when this process is inside already.
pub(crate) fn inside_namespace(test: &str) -> bool {
    if env::var_os(INSIDE).is_some() {
        veth_pair("master0", "slave0");
        return true;
    }
    let possible = Command::new("setpriv")
        .args(["--pdeathsig", "KILL", "unshare", "-rn", "true"])
        .status()
        .is_ok_and(|status| status.success())
        && Command::new("ip")
            .arg("-V")
            .stdout(Stdio::null())
            .status()
            .is_ok_and(|status| status.success());
    if !possible {
        let message = format!(
            "{test}: SKIPPED: no network namespace can be made here (setpriv, unshare -rn, ip)"
        );
        assert_ne!(
            env::var("CI").as_deref(),
            Ok("true"),
            "{message}, and in CI that is a failure"
        );
        say(&message);
        return false;
    }
    // It ends with this process, however that ends. Ahead of other work, where that is allowed: the processes inside talk in milliseconds.
    let output = Command::new("setpriv")
        .args(["--pdeathsig", "KILL", "nice", "-n", "-10", "unshare", "-rn"])
        .arg(env::current_exe().expect("this test has a path"))
        .args(["--exact", test, "--nocapture", "--test-threads=1"])
        .env(INSIDE, "1")
        .output()
        .expect("unshare has just worked");
    // By these the test's own capture decides what is shown, and where.
    print!("{}", String::from_utf8_lossy(&output.stdout));
    eprint!("{}", String::from_utf8_lossy(&output.stderr));
    assert!(
        output.status.success(),
        "{test} failed inside its namespace"
    );
    assert_one_ran(test, &output.stdout);
    false
}

/// That the test was run again: by a name that nothing has none is, and that is a success.
pub(crate) fn assert_one_ran(test: &str, output: &[u8]) {
    let said = String::from_utf8_lossy(output);
    assert!(
        said.contains("1 passed;"),
        "no test is called {test}: {said}"
    );
}

/// Makes a cable: two interfaces that are up.
pub(crate) fn veth_pair(near: &str, far: &str) {
    run(
        "ip",
        &["link", "add", near, "type", "veth", "peer", "name", far],
    );
    for interface in [near, far] {
        run("ip", &["link", "set", interface, "up"]);
    }
}

/// Says something past the test's capture, so that a test that passes without having run does not do so unseen.
pub(crate) fn say(message: &str) {
    // Where nobody listens there is nothing to be done.
    let _ = writeln!(io::stderr(), "{message}");
}

/// Runs a program to its end, which must be success.
pub(crate) fn run(program: &str, arguments: &[&str]) {
    let status = Command::new(program)
        .args(arguments)
        .status()
        .expect("the program is there");
    assert!(status.success(), "{program} {arguments:?}: {status}");
}

/// A process that ends with its owner, by its own id.
pub(crate) struct Process(pub(crate) Child);

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The simulated segment with these devices in a line, listening on `slave0`, for `seconds` at most.
pub(crate) fn simulated(
    program: &Path,
    devices: &[&str],
    seconds: u32,
    trace: Option<&Path>,
) -> Process {
    let trace = trace.map(|file| ["--trace".to_owned(), file.display().to_string()]);
    simulated_with(
        program,
        devices,
        seconds,
        trace.as_ref().map_or(&[], |trace| trace),
    )
}

/// The same with options of the program.
pub(crate) fn simulated_with(
    program: &Path,
    devices: &[&str],
    seconds: u32,
    options: &[String],
) -> Process {
    simulated_on("slave0", program, devices, seconds, options)
}

/// The same on another interface.
pub(crate) fn simulated_on(
    interface: &str,
    program: &Path,
    devices: &[&str],
    seconds: u32,
    options: &[String],
) -> Process {
    let mut command = Command::new(program);
    command.args(["--interface", interface, "--for", &seconds.to_string()]);
    for device in devices {
        command.args(["--drive", device]);
    }
    command.args(options);
    let mut child = command
        .stdout(Stdio::piped())
        .spawn()
        .expect("the simulator starts");
    let mut line = String::new();
    let mut says = BufReader::new(child.stdout.take().expect("piped"));
    says.read_line(&mut line).expect("a line");
    // What it says at its end is for whoever reads on.
    child.stdout = Some(says.into_inner());
    let listening = format!("listening on {interface}: {} SubDevice(s)", devices.len());
    assert_eq!(line.trim(), listening);
    Process(child)
}
