//! The real link: the library on one end of a veth pair, the simulated segment's own process on the other.
//!
//! The tests run again inside a network namespace of their own. Where none can be made they say so and pass, but fail when
//! `CI=true`.

use std::{
    env, fs,
    io::{BufRead, BufReader, Read},
    path::PathBuf,
    process::{Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};

use crate::namespace::{Process, inside_namespace, run, say, simulated, simulated_on, veth_pair};
use servocrab::{
    AxisConfig, DriveConfig, Network, NetworkError, Outcome, Referencing, SetPoint,
    bus::{NetworkBuilder, Statistics},
    drives,
};

/// A program of this workspace, as built with the tests.
fn program(name: &str) -> PathBuf {
    let deps = env::current_exe().expect("this test has a path");
    let profile = deps.ancestors().nth(2).expect("target/PROFILE/deps/TEST");
    let path = profile.join(name);
    assert!(
        path.exists(),
        "{} is not built: run `cargo test --workspace`",
        path.display()
    );
    path
}

impl Process {
    /// Waits for its end, which must come within the limit.
    fn wait(&mut self, limit: Duration) -> ExitStatus {
        let end = Instant::now() + limit;
        loop {
            if let Some(status) = self.0.try_wait().expect("it is our child") {
                return status;
            }
            assert!(Instant::now() < end, "still running after {limit:?}");
            std::thread::yield_now();
        }
    }

    /// Sends it a signal by name.
    fn signal(&self, signal: &str) {
        run("kill", &[&format!("-{signal}"), &self.0.id().to_string()]);
    }
}

/// The simulated segment, listening; its trace is in the file.
fn simulator(test: &str) -> (Process, PathBuf) {
    simulator_of(test, "akd2g")
}

fn simulator_of(test: &str, device: &str) -> (Process, PathBuf) {
    let trace = env::temp_dir().join(format!("servocrab-{test}-{}.csv", std::process::id()));
    let simulator = simulated(&program("servocrab-sim"), &[device], 60, Some(&trace));
    (simulator, trace)
}

fn pp_move(arguments: &[&str]) -> Process {
    let child = Command::new(program("examples/pp_move"))
        // A machine that is busy with other things loses no drive.
        .args(["--interface", "master0", "--watchdog-ms", "2000"])
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("pp_move starts");
    Process(child)
}

/// Reads the program's output up to a line that begins like this.
fn read_to(process: &mut Process, begin: &str) -> BufReader<std::process::ChildStdout> {
    let mut output = BufReader::new(process.0.stdout.take().expect("piped"));
    let mut line = String::new();
    while !line.starts_with(begin) {
        line.clear();
        if output.read_line(&mut line).expect("text") == 0 {
            let mut errors = String::new();
            let _ = process
                .0
                .stderr
                .take()
                .map(|mut e| e.read_to_string(&mut errors));
            panic!("pp_move ended before {begin:?}: {errors}");
        }
    }
    output
}

/// The first row out of OP after OP.
fn fell_from_op(rows: &[Row]) -> Option<usize> {
    let in_op = rows.iter().position(|row| row.al_state == 8)?;
    let fell = rows[in_op..].iter().position(|row| row.al_state == 4)?;
    // Some cycles more, so that the stop is in the trace too.
    (rows.len() > in_op + fell + 200).then_some(in_op + fell)
}

#[derive(Debug, Clone)]
struct Row {
    time_s: f64,
    drive: usize,
    axis: u8,
    /// 1 INIT, 2 PREOP, 4 SAFEOP, 8 OP.
    al_state: u8,
    controlword: u16,
    statusword: u16,
    position: f64,
    velocity: f64,
}

impl Row {
    /// Whether the shaft rests: what is left of its swing is slower than a count in a millisecond.
    fn rests(&self) -> bool {
        self.velocity.abs() < 1_000.0
    }
}

/// Ends the simulator in order and reads what it wrote of axis 1.
fn trace(simulator: Process, file: &PathBuf) -> Vec<Row> {
    let mut rows = whole_trace(simulator, file);
    rows.retain(|row| row.axis == 1);
    rows
}

/// Ends the simulator in order and reads what it wrote.
fn whole_trace(mut simulator: Process, file: &PathBuf) -> Vec<Row> {
    simulator.signal("TERM");
    assert!(simulator.wait(Duration::from_secs(10)).success());
    let rows = rows(file);
    fs::remove_file(file).expect("it is ours");
    rows
}

/// What the trace holds of axis 1 so far, in whole lines.
fn rows_of_axis_1(file: &PathBuf) -> Vec<Row> {
    let mut rows = rows(file);
    rows.retain(|row| row.axis == 1);
    rows
}

/// What the trace holds so far, in whole lines.
fn rows(file: &PathBuf) -> Vec<Row> {
    let text = fs::read_to_string(file).expect("the trace is there");
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let mut lines = whole.lines();
    let Some(header) = lines.next() else {
        return Vec::new();
    };
    assert_eq!(
        header,
        "time_s,drive,axis,al_state,controlword,statusword,target,position,velocity"
    );
    let row = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        Row {
            time_s: fields[0].parse().expect("time"),
            drive: fields[1].parse().expect("drive"),
            axis: fields[2].parse().expect("axis"),
            al_state: fields[3].parse().expect("AL state"),
            controlword: fields[4].parse().expect("controlword"),
            statusword: fields[5].parse().expect("statusword"),
            position: fields[7].parse().expect("position"),
            velocity: fields[8].parse().expect("velocity"),
        }
    };
    lines.map(row).collect()
}

#[test]
fn a_move_over_the_wire_reaches_its_target_and_exits_with_success() {
    if !inside_namespace("programs::a_move_over_the_wire_reaches_its_target_and_exits_with_success")
    {
        return;
    }
    let (simulator, file) = simulator("move");
    let mut program = pp_move(&["--to", "12345", "--velocity", "50000"]);
    let mut output = read_to(&mut program, "Reached");
    assert!(program.wait(Duration::from_secs(10)).success());
    let _ = output.read_to_string(&mut String::new());
    let rows = trace(simulator, &file);
    let last = rows.last().expect("rows");
    assert!((last.position - 12345.0).abs() <= 10.0, "{}", last.position);
    assert_ne!(last.statusword & 0x6F, 0x27, "it ends disabled");
    assert!(
        rows.iter().any(|row| row.controlword == 0x3F),
        "bit 4 and bit 5 were on the wire"
    );
}

#[test]
fn killed_in_mid_move_the_drive_stops_by_its_watchdog() {
    if !inside_namespace("programs::killed_in_mid_move_the_drive_stops_by_its_watchdog") {
        return;
    }
    let (simulator, file) = simulator("kill");
    let mut program = pp_move(&["--to", "1000000", "--velocity", "50000"]);
    let _output = read_to(&mut program, "moving");
    program.signal("KILL");
    program.wait(Duration::from_secs(10));
    // The simulator's own clock decides: it runs on until its trace shows the drive out of OP.
    let end = Instant::now() + Duration::from_secs(20);
    while fell_from_op(&rows_of_axis_1(&file)).is_none() {
        assert!(Instant::now() < end, "the drive has not left OP");
        std::thread::yield_now();
    }
    let rows = trace(simulator, &file);
    let fell = fell_from_op(&rows).expect("it has just been seen");
    assert!(rows[fell - 1].velocity > 0.0, "it was moving until then");
    let last = rows.last().expect("rows");
    assert!(last.rests(), "velocity {}", last.velocity);
    assert!(
        last.position < 1_000_000.0,
        "it stopped short of its target"
    );
}

#[test]
fn ctrl_c_in_mid_move_stops_and_disables() {
    if !inside_namespace("programs::ctrl_c_in_mid_move_stops_and_disables") {
        return;
    }
    let (simulator, file) = simulator("interrupt");
    let mut program = pp_move(&["--to", "1000000", "--velocity", "50000"]);
    let mut output = read_to(&mut program, "moving");
    program.signal("INT");
    let status = program.wait(Duration::from_secs(10));
    assert_eq!(status.code(), Some(1), "interrupted is not reached");
    let mut rest = String::new();
    output.read_to_string(&mut rest).expect("text");
    assert!(rest.starts_with("disabled at "), "{rest:?}");
    let rows = trace(simulator, &file);
    let last = rows.last().expect("rows");
    assert!(last.rests(), "velocity {}", last.velocity);
    assert!(last.position < 1_000_000.0);
    assert_eq!(last.statusword & 0x4F, 0x40, "Switch on disabled");
    assert_ne!(last.al_state, 8, "OP was left");
    let stopping = rows
        .iter()
        .find(|row| row.controlword & 0x100 != 0)
        .expect("bit 8 came first");
    assert!(stopping.time_s < last.time_s);
}

#[test]
fn ctrl_c_in_a_bring_up_ends_it_and_takes_the_drive_back_into_init() {
    if !inside_namespace(
        "programs::ctrl_c_in_a_bring_up_ends_it_and_takes_the_drive_back_into_init",
    ) {
        return;
    }
    let file = env::temp_dir().join(format!("servocrab-bring-up-{}.csv", std::process::id()));
    let trace = file.display().to_string();
    // So slow that its mapping takes seconds.
    let slow = ["--mailbox-ms", "100", "--trace", &trace].map(str::to_owned);
    let line = simulated_on("slave0", &program("servocrab-sim"), &["akd2g"], 60, &slow);
    let program = pp_move(&["--to", "1"]);
    let end = Instant::now() + Duration::from_secs(20);
    while rows(&file).last().is_none_or(|row| row.al_state != 2) {
        assert!(Instant::now() < end, "the drive is not in PREOP");
        std::thread::yield_now();
    }
    program.signal("INT");
    assert_eq!(
        failure(program, Duration::from_secs(10)),
        "pp_move: interrupted: the bring-up has ended\n"
    );
    let rows = whole_trace(line, &file);
    assert!(rows.iter().all(|row| row.al_state <= 2), "not above PREOP");
    assert_eq!(rows.last().expect("rows").al_state, 1);
}

/// What this program says of the drive at the other end of the cable, where it ends well.
fn said_by(name: &str) -> String {
    said_by_with(name, &[])
}

/// The same with these arguments.
fn said_by_with(name: &str, arguments: &[&str]) -> String {
    let done = Command::new(program(name))
        .args(["--interface", "master0"])
        .args(arguments)
        .output()
        .expect("it starts");
    let said = String::from_utf8_lossy(&done.stdout).into_owned();
    let errors = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{said}{errors}");
    said
}

#[test]
fn home_and_jog_runs_on_a_drive_at_the_other_end_of_the_cable() {
    if !inside_namespace("programs::home_and_jog_runs_on_a_drive_at_the_other_end_of_the_cable") {
        return;
    }
    let machine = [
        "--stands-at",
        "327680",
        "--limit-switches",
        "196608..100000000",
    ];
    let machine = machine.map(str::to_owned);
    let simulator = program("servocrab-sim");
    let _line = simulated_on("slave0", &simulator, &["generic"], 60, &machine);
    let said = said_by("examples/home_and_jog");
    assert!(said.contains("referenced: true"), "{said}");
    assert!(said.contains("after homing: Reached"), "{said}");
    let refused = Command::new(program("examples/recover"))
        .args(["--interface", "master0"])
        .output()
        .expect("it starts");
    assert_eq!(refused.status.code(), Some(2), "it takes no arguments");
}

#[test]
fn measure_finds_a_part_at_the_other_end_of_the_cable() {
    if !inside_namespace("programs::measure_finds_a_part_at_the_other_end_of_the_cable") {
        return;
    }
    let part = ["--probe", "250000..300000"].map(str::to_owned);
    let simulator = program("servocrab-sim");
    let _line = simulated_on("slave0", &simulator, &["generic"], 60, &part);
    let said = said_by("examples/measure");
    assert!(said.contains("the part begins at 25.000 mm"), "{said}");
    assert!(said.contains("it ends at 30.000 mm"), "{said}");
    assert!(said.contains("touched at 30.000 mm"), "{said}");
}

#[test]
fn press_arrives_where_nothing_is_in_the_way() {
    if !inside_namespace("programs::press_arrives_where_nothing_is_in_the_way") {
        return;
    }
    let simulator = program("servocrab-sim");
    let _line = simulated_on("slave0", &simulator, &["generic"], 60, &[]);
    let said = said_by("examples/press");
    assert!(
        said.contains("nothing was in the way: reached 40"),
        "{said}"
    );
    assert!(said.contains("back"), "{said}");
}

#[test]
fn gantry_squares_and_moves_two_drives_at_the_other_end_of_the_cable() {
    if !inside_namespace(
        "programs::gantry_squares_and_moves_two_drives_at_the_other_end_of_the_cable",
    ) {
        return;
    }
    let machine = ["--limit-switches", "-200000..100000000"].map(str::to_owned);
    let simulator = program("servocrab-sim");
    let devices = ["generic", "generic"];
    let _line = simulated_on("slave0", &simulator, &devices, 60, &machine);
    let said = said_by("examples/gantry");
    assert!(said.contains("both are home"), "{said}");
    for target in [60, 10] {
        let at = |side: &str| {
            side.parse()
                .is_ok_and(|at: f64| (at - f64::from(target)).abs() < 0.01)
        };
        let mut lines = said.lines().filter_map(|line| line.strip_prefix("at "));
        let is_there = lines.any(|line| {
            let sides = line
                .split(" and ")
                .filter_map(|side| side.strip_suffix(" mm"));
            sides.filter(|side| at(side)).count() == 2
        });
        assert!(is_there, "{said}");
    }
}

#[test]
fn tool_changer_uses_a_tool_twice_that_is_pulled_in_between_beside_a_moving_drive() {
    if !inside_namespace(
        "programs::tool_changer_uses_a_tool_twice_that_is_pulled_in_between_beside_a_moving_drive",
    ) {
        return;
    }
    let file = env::temp_dir().join(format!("servocrab-tool-{}.csv", std::process::id()));
    let mut options = ["--alias", "1=7", "--trace", &file.display().to_string()]
        .map(str::to_owned)
        .to_vec();
    // Once is enough. Where this machine is so busy that frames come back late, a plugged connector may be taken for one that is half in; it
    // is pulled and plugged again then.
    for pulled in (4..56).step_by(4) {
        options.extend(["--unplug".to_owned(), format!("1@{pulled}..{}", pulled + 1)]);
    }
    let simulator = program("servocrab-sim");
    let devices = ["generic", "generic"];
    let line = simulated_on("slave0", &simulator, &devices, 60, &options);
    let said = said_by_with("examples/tool_changer", &["--drive", "0"]);
    let mut rest = said.as_str();
    for told in [
        "event: group `drill` has joined, with drive 1 \"drill\"",
        "the spindle has turned",
        "event: group `drill` has left, with drive 1 \"drill\"",
        "event: group `drill` has joined, with drive 1 \"drill\"",
        "the spindle has turned",
        "drive 0 \"CiA402\": silent in ",
    ] {
        let (_, behind) = rest.split_once(told).unwrap_or_else(|| panic!("{said}"));
        rest = behind;
    }
    let rows = whole_trace(line, &file);
    let of = |drive| rows.iter().filter(move |row| row.drive == drive);
    let (lasting, tool): (Vec<_>, Vec<_>) = (of(0).collect(), of(1).collect());
    let is_enabled = |row: &&Row| row.al_state == 8 && row.statusword & 0x6F == 0x27;
    assert_eq!(times(&lasting, |row| row.al_state == 8), 1, "{said}");
    assert_eq!(times(&lasting, is_enabled), 1, "{said}");
    assert!(times(&tool, |row| row.al_state == 8) >= 2, "{said}");
    // The other one moves on while the tool is out. In how many cycles it is silent is a matter of how late this machine lets the simulator
    // answer: `.ci/examples` sees that it is none where nothing is late.
    let in_op = |row: &&&Row| row.al_state == 8;
    let once_joined = tool.iter().skip_while(|row| !in_op(row));
    let once_left = once_joined.skip_while(in_op);
    let out: Vec<_> = once_left.take_while(|row| !in_op(row)).collect();
    let while_out = out[0].time_s..out[out.len() - 1].time_s;
    let rows = lasting.iter().filter(|row| while_out.contains(&row.time_s));
    let positions = rows.map(|row| row.position);
    let least = positions.clone().fold(f64::INFINITY, f64::min);
    let most = positions.fold(f64::NEG_INFINITY, f64::max);
    assert!(most - least > 10_000.0, "{least} to {most}");
    // Whenever it joins it is disabled, and stays so until it is used.
    assert_eq!(times(&tool, is_enabled), 2, "{said}");
    let ends = [lasting.last(), tool.last()].map(|row| row.expect("rows"));
    let [_, used] = ends;
    assert!((used.position - 10_000.0).abs() <= 20.0, "{used:?}");
    assert!(ends.iter().all(|row| row.al_state < 8), "{ends:?}");
}

/// How often this begins to hold.
fn times(rows: &[&Row], holds: impl Fn(&&Row) -> bool) -> usize {
    let begins = |pair: &&[&Row]| !holds(&pair[0]) && holds(&pair[1]);
    rows.windows(2).filter(begins).count()
}

#[test]
fn ctrl_c_in_a_homing_stops_and_disables() {
    if !inside_namespace("programs::ctrl_c_in_a_homing_stops_and_disables") {
        return;
    }
    let file = env::temp_dir().join(format!("servocrab-homing-{}.csv", std::process::id()));
    let trace = file.display().to_string();
    // A limit switch so far away that the homing takes minutes.
    let machine = [
        "--stands-at",
        "100000000",
        "--limit-switches",
        "0..200000000",
    ];
    let options = [machine.as_slice(), &["--trace", &trace]].concat();
    let options: Vec<_> = options.into_iter().map(str::to_owned).collect();
    let simulator = program("servocrab-sim");
    let line = simulated_on("slave0", &simulator, &["generic"], 60, &options);
    let example = Command::new(program("examples/home_and_jog"))
        .args(["--interface", "master0"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map(Process)
        .expect("it starts");
    let moves = |rows: &[Row]| rows.iter().any(|row| row.velocity < -10_000.0);
    let end = Instant::now() + Duration::from_secs(20);
    while !moves(&rows(&file)) {
        assert!(Instant::now() < end, "it does not home");
        std::thread::yield_now();
    }
    example.signal("INT");
    assert_eq!(
        failure(example, Duration::from_secs(10)),
        "home_and_jog: interrupted: stopped and disabled\n"
    );
    let rows = whole_trace(line, &file);
    let last = rows.last().expect("rows");
    assert!(last.rests(), "velocity {}", last.velocity);
    assert_eq!(last.statusword & 0x4F, 0x40, "Switch on disabled");
    assert_ne!(last.al_state, 8, "OP was left");
}

#[test]
fn a_move_whose_output_nobody_reads_ends_quietly_at_its_target() {
    if !inside_namespace("programs::a_move_whose_output_nobody_reads_ends_quietly_at_its_target") {
        return;
    }
    let (simulator, file) = simulator("unread");
    let mut program = pp_move(&["--to", "12345", "--velocity", "50000"]);
    drop(program.0.stdout.take());
    let status = program.wait(Duration::from_secs(20));
    let mut errors = String::new();
    let said = program.0.stderr.take();
    said.expect("piped")
        .read_to_string(&mut errors)
        .expect("text");
    assert!(status.success() && errors.is_empty(), "{errors}");
    let last = trace(simulator, &file).pop().expect("rows");
    assert!((last.position - 12345.0).abs() <= 10.0, "{}", last.position);
}

#[test]
fn an_example_whose_output_nobody_reads_goes_on_to_its_end() {
    let mut child = Command::new(program("examples/home_and_jog"))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    drop(child.stdout.take());
    let ended = child.wait_with_output().expect("it is our child");
    let errors = String::from_utf8_lossy(&ended.stderr);
    assert!(ended.status.success() && errors.is_empty(), "{errors}");
}

/// Runs `program` to its end, which must be a failure, and gives what it wrote about it.
fn failure(mut program: Process, limit: Duration) -> String {
    let code = program.wait(limit).code();
    let mut text = String::new();
    program
        .0
        .stderr
        .take()
        .expect("piped")
        .read_to_string(&mut text)
        .expect("text");
    assert_eq!(code, Some(1), "{text}");
    text
}

#[test]
fn a_missing_interface_is_named_in_the_error() {
    if !inside_namespace("programs::a_missing_interface_is_named_in_the_error") {
        return;
    }
    let program = Command::new(program("examples/pp_move"))
        .args(["--interface", "nosuch0", "--to", "1"])
        .stderr(Stdio::piped())
        .spawn()
        .map(Process)
        .expect("pp_move starts");
    assert_eq!(
        failure(program, Duration::from_secs(10)),
        "pp_move: there is no network interface `nosuch0`\n"
    );
}

#[test]
fn an_interface_that_is_down_is_named_in_the_error() {
    if !inside_namespace("programs::an_interface_that_is_down_is_named_in_the_error") {
        return;
    }
    run("ip", &["link", "set", "master0", "down"]);
    assert_eq!(
        failure(pp_move(&["--to", "1"]), Duration::from_secs(10)),
        "pp_move: the network interface `master0` is down: bring it up (`ip link set master0 up`)\n"
    );
}

#[test]
fn an_empty_line_is_an_error_that_says_so() {
    if !inside_namespace("programs::an_empty_line_is_an_error_that_says_so") {
        return;
    }
    assert_eq!(
        failure(pp_move(&["--to", "1"]), Duration::from_secs(30)),
        "pp_move: no frame came back: is the cable plugged in, and the first SubDevice powered?\n"
    );
}

#[test]
fn an_attempt_that_failed_leaves_the_interface_to_the_next() {
    if !inside_namespace("programs::an_attempt_that_failed_leaves_the_interface_to_the_next") {
        return;
    }
    let builder = || Network::builder().interface("master0");
    let drive = || DriveConfig::new(drives::akd2g()).axis("x");
    smol::block_on(async {
        for _ in 0..2 {
            let error = builder().drive(0, drive()).start().await.unwrap_err();
            assert!(matches!(error, NetworkError::NoAnswer), "{error}");
            let error = builder().scan().await.unwrap_err();
            assert!(matches!(error, NetworkError::NoAnswer), "{error}");
        }
    });
}

#[test]
fn without_the_capability_the_error_says_how_to_get_it() {
    if !inside_namespace("programs::without_the_capability_the_error_says_how_to_get_it") {
        return;
    }
    let without = |program: &str| {
        let mut command = Command::new("setpriv");
        command
            .args(["--bounding-set", "-net_raw", "--inh-caps", "-net_raw"])
            .arg(program)
            .stderr(Stdio::piped());
        command
    };
    if !without("true")
        .status()
        .is_ok_and(|status| status.success())
    {
        let message = "SKIPPED: no capability can be taken away here (setpriv)";
        assert_ne!(
            env::var("CI").as_deref(),
            Ok("true"),
            "{message}, and in CI that is a failure"
        );
        say(message);
        return;
    }
    let program = program("examples/pp_move");
    let program = without(program.to_str().expect("a path of ours"))
        .args(["--interface", "master0", "--to", "1"])
        .spawn()
        .map(Process)
        .expect("pp_move starts");
    assert_eq!(
        failure(program, Duration::from_secs(10)),
        "pp_move: no permission to open a raw socket: run as root, or give the program the capability (`setcap \
         cap_net_raw+ep <program>`; where it asks for real time too, all in one: `setcap \
         cap_net_raw,cap_sys_nice,cap_ipc_lock+ep <program>`, since those that are not named are taken away)\n"
    );
}

#[test]
fn another_device_at_the_drives_position_is_an_error_with_both_identities() {
    if !inside_namespace(
        "programs::another_device_at_the_drives_position_is_an_error_with_both_identities",
    ) {
        return;
    }
    let (simulator, file) = simulator_of("identity", "coupler");
    let text = failure(pp_move(&["--to", "1"]), Duration::from_secs(30));
    drop(simulator);
    fs::remove_file(file).expect("it is ours");
    assert!(
        text.starts_with(
            "pp_move: the line is not the expected one, and nothing was configured:\n"
        ) && text.contains(" AKD2G (0000006Ah:any) ")
            && text.contains(" Coupler (00000000h:434F5550h, ")
            && text.trim_end().ends_with("another device"),
        "{text}"
    );
}

/// A line at `slave{place}`, its trace, and the network of it at `master{place}`.
fn network(place: usize, devices: &[&str]) -> (Process, PathBuf, NetworkBuilder) {
    let file = env::temp_dir().join(format!("servocrab-two-{place}-{}.csv", std::process::id()));
    let trace = ["--trace".to_owned(), file.display().to_string()];
    let program = program("servocrab-sim");
    let simulator = simulated_on(&format!("slave{place}"), &program, devices, 60, &trace);
    // A machine that is busy with other things loses no drive.
    let builder = Network::builder()
        .interface(&format!("master{place}"))
        .watchdog(Duration::from_secs(6));
    let builder = (0..).zip(devices).fold(builder, |builder, (drive, _)| {
        let names = [1, 2].map(|axis| format!("{drive}.{axis}"));
        let config = names
            .iter()
            .fold(DriveConfig::new(drives::akd2g()), |config, name| {
                config
                    .axis(AxisConfig::new(name).referencing(Referencing::UnreferencedMovesAllowed))
            });
        builder.drive(drive, config)
    });
    (simulator, file, builder)
}

/// The targets of an axis, which no other one has.
fn targets(place: usize, drive: usize, axis: u8) -> [i32; 5] {
    let own = 1_000 * (place + 1) as i32 + 100 * drive as i32 + 10 * i32::from(axis);
    [own, -own, 2 * own, 0, own + 1]
}

/// Moves all axes of a network at once, each through its targets.
async fn move_all(builder: NetworkBuilder, place: usize, drives: usize) -> Statistics {
    let net = builder.start().await.unwrap();
    let executor = smol::LocalExecutor::new();
    let axes = (0..drives).flat_map(|drive| [(drive, 1), (drive, 2)]);
    let tasks: Vec<_> = axes
        .map(|(drive, number)| {
            let axis = net.axis(&format!("{drive}.{number}")).unwrap();
            executor.spawn(async move {
                let set_point = SetPoint::new()
                    .velocity(200_000)
                    .acceleration(5_000_000)
                    .deceleration(5_000_000);
                axis.enable().await.unwrap();
                let mode = axis.profile_position().await.unwrap();
                for target in targets(place, drive, number) {
                    let motion = mode.move_abs(target, set_point).await.unwrap();
                    let outcome = motion.done().await.unwrap();
                    assert!(matches!(outcome, Outcome::Reached { .. }), "{outcome:?}");
                }
            })
        })
        .collect();
    executor
        .run(async {
            for task in tasks {
                task.await;
            }
        })
        .await;
    let statistics = net.statistics();
    net.shutdown().await.unwrap();
    statistics
}

#[test]
fn two_networks_in_one_process_move_their_own_axes_and_see_nothing_of_each_other() {
    if !inside_namespace(
        "programs::two_networks_in_one_process_move_their_own_axes_and_see_nothing_of_each_other",
    ) {
        return;
    }
    veth_pair("master1", "slave1");
    let lines = [vec!["akd2g"; 1], vec!["akd2g"; 2]];
    let [one, two] = [0, 1].map(|place| network(place, &lines[place]));
    let moves = smol::future::zip(
        move_all(one.2, 0, lines[0].len()),
        move_all(two.2, 1, lines[1].len()),
    );
    let (first, second) = smol::block_on(moves);
    for statistics in [first, second] {
        let strange = (
            statistics.foreign,
            statistics.damaged,
            statistics.wrong_working_counters,
        );
        assert_eq!(strange, (0, 0, 0), "{statistics:?}");
        assert!(statistics.cycles > 100, "{statistics:?}");
    }
    for (place, (simulator, file, _)) in [(0, (one.0, one.1, ())), (1, (two.0, two.1, ()))] {
        let rows = whole_trace(simulator, &file);
        for (drive, axis) in (0..lines[place].len()).flat_map(|drive| [(drive, 1), (drive, 2)]) {
            let own: Vec<_> = rows
                .iter()
                .filter(|row| (row.drive, row.axis) == (drive, axis))
                .collect();
            // Bit 12 rises with each set-point that is taken.
            let taken = own
                .windows(2)
                .filter(|rows| !rows[0].statusword & rows[1].statusword & 0x1000 != 0)
                .count();
            let targets = targets(place, drive, axis);
            assert_eq!(
                taken,
                targets.len(),
                "line {place}, drive {drive}, axis {axis}"
            );
            // The shaft of a real axis rests within its window, not on the count.
            let last = own.last().expect("rows").position;
            assert!(
                (last - f64::from(targets[4])).abs() <= 10.0,
                "line {place}, drive {drive}: {last}"
            );
        }
    }
}
