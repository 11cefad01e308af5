//! What is in the log of things that no handle waits for, with the axis and the drive that they happened to.

use std::{cell::RefCell, io, sync::Once, time::Duration};

use servocrab::{
    AxisConfig, DriveConfig, Network, Referencing, StopRequest,
    bus::DistributedClock,
    drives,
    units::{Mm, Ratio, Scale},
};
use servocrab_sim::{Segment, personality};
use tracing::Level;

use crate::rig::{Line, Rig, akd2g, unhomed};

const MS: Duration = Duration::from_millis(1);

thread_local! {
    static LINES: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

/// What is logged on this thread, where the bus loop of a [`Rig`] runs.
///
/// One subscriber serves all tests: subscribers that come and go with their threads make `tracing` forget, now and then,
/// that somebody listens.
pub(crate) struct Log;

impl io::Write for Log {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        LINES.with_borrow_mut(|lines| lines.extend_from_slice(bytes));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Log {
    /// Forgets what this thread has logged so far.
    pub(crate) fn begin() -> Self {
        static SUBSCRIBED: Once = Once::new();
        SUBSCRIBED.call_once(|| {
            let subscriber = tracing_subscriber::fmt()
                .with_max_level(Level::DEBUG)
                .with_ansi(false)
                .without_time()
                .with_writer(|| Log)
                .finish();
            tracing::subscriber::set_global_default(subscriber).unwrap();
        });
        LINES.take();
        Self
    }

    /// The lines since this was asked for last.
    pub(crate) fn take(&self) -> Vec<String> {
        let bytes = LINES.take();
        let text = String::from_utf8(bytes).unwrap();
        text.lines().map(str::to_owned).collect()
    }
}

/// How many of the lines have all of these parts.
pub(crate) fn count(lines: &[String], parts: &[&str]) -> usize {
    lines
        .iter()
        .filter(|line| parts.iter().all(|part| line.contains(part)))
        .count()
}

fn two_drives() -> (Line, Rig) {
    let line = Line::new(
        Segment::new()
            .with(personality::akd2g())
            .with(personality::akd2g()),
    );
    let second = unhomed(drives::akd2g(), &["z"]);
    let builder = Network::builder()
        .link(line.wire())
        .drive(0, akd2g())
        .drive(1, second);
    let rig = Rig::start(builder).unwrap();
    (line, rig)
}

#[test]
fn each_drives_bring_up_is_a_span_with_its_position_and_name() {
    let log = Log::begin();
    let (_line, rig) = two_drives();
    let lines = log.take();
    for position in ["position=0", "position=1"] {
        let span = format!("bring-up{{{position} name=\"AKD2G\"}}");
        assert_eq!(count(&lines, &[&span, "configuring"]), 1, "{lines:#?}");
        assert_eq!(count(&lines, &[&span, "in SAFEOP"]), 1, "{lines:#?}");
    }
    assert_eq!(count(&lines, &["INFO", "drive 1 \"AKD2G\"", "in OP"]), 1);
    rig.shutdown();
}

#[test]
fn each_line_has_one_of_three_targets_and_an_axis_its_own_unit() {
    let log = Log::begin();
    let line = Line::new(Segment::new().with(personality::akd2g()));
    let scale = Scale::counts_per_unit(Ratio::new(1_000, 1).unwrap());
    let axis = AxisConfig::new("x")
        .unit::<Mm>(scale)
        .referencing(Referencing::AbsoluteEncoder);
    let drive = DriveConfig::new(drives::akd2g()).axis(axis);
    let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
    rig.moved("x", 20_000);
    rig.run_for(200 * MS);
    let x = rig.net().axis("x").unwrap();
    rig.until(x.disable()).unwrap();
    rig.net().stop_handle().stop_all(StopRequest::HALT);
    rig.run_for(20 * MS);
    let lines = log.take();
    for parts in [
        ["servocrab::bus: ", "SubDevices in PREOP"],
        ["servocrab::drive: ", "in SAFEOP"],
        ["servocrab::drive: ", "in OP"],
        ["servocrab::bus: ", "all axes are stopped"],
    ] {
        assert_eq!(count(&lines, &parts), 1, "{parts:?}: {lines:#?}");
    }
    let disabled = lines
        .iter()
        .find(|line| line.contains("from=OperationEnabled"));
    let disabled = disabled.expect("it was disabled");
    assert!(disabled.contains("servocrab::axis: "), "{disabled}");
    let position = disabled.split("position=").nth(1).unwrap();
    let (position, rest) = position.split_once(' ').unwrap();
    let position: f64 = position.parse().unwrap();
    assert!((position - 20.0).abs() < 0.05, "{disabled}");
    assert!(rest.starts_with("mm "), "{disabled}");
    let of_ours = |line: &&String| line.contains("servocrab");
    let known = [
        "servocrab::axis: ",
        "servocrab::drive: ",
        "servocrab::bus: ",
    ];
    for line in lines.iter().filter(of_ours) {
        let targets = known.iter().filter(|target| line.contains(**target));
        assert_eq!(targets.count(), 1, "{line}");
    }
    drop(x);
    rig.shutdown();
}

#[test]
fn a_fault_that_nobody_waits_for_is_logged_once_with_its_axis_and_its_drive() {
    let (line, mut rig) = two_drives();
    let z = rig.net().axis("z").unwrap();
    // A move is under way, so the drive decelerates in Fault reaction active before it is in Fault.
    let _moving = rig.starts_a_long_move("z");
    rig.run_for(20 * MS);
    let log = Log::begin();
    rig.run_for(100 * MS);
    assert_eq!(log.take(), [""; 0], "nothing has happened");
    line.segment().axis_mut(1, 0).unwrap().inject_fault(0x7320);
    rig.run_for(500 * MS);
    let lines = log.take();
    let fault = [
        "ERROR",
        "axis=\"z\"",
        "drive=drive 1 \"AKD2G\"",
        "to=FaultReactionActive ",
        "statusword=",
    ];
    assert_eq!(count(&lines, &fault), 1, "{lines:#?}");
    assert_eq!(count(&lines, &["ERROR"]), 1, "{lines:#?}");
    let ended = ["DEBUG", "axis=\"z\"", "from=FaultReactionActive to=Fault "];
    assert_eq!(count(&lines, &ended), 1, "{lines:#?}");
    let emergency = [
        "WARN",
        "drive=drive 1 \"AKD2G\"",
        "emergency",
        "code=7320h",
        "text=position",
    ];
    assert_eq!(count(&lines, &emergency), 1, "{lines:#?}");
    assert_eq!(count(&lines, &["axis=\"x\""]), 0, "{lines:#?}");
    drop(z);
    rig.shutdown();
}

#[test]
fn a_stop_from_the_stop_lane_and_an_unfed_liveness_are_logged_once() {
    let (_line, mut rig) = two_drives();
    let _moving = rig.starts_a_long_move("x");
    let live = rig.net().liveness(50 * MS).unwrap();
    live.feed();
    rig.run_for(20 * MS);
    let log = Log::begin();
    rig.run_for(200 * MS);
    let lines = log.take();
    assert_eq!(count(&lines, &["WARN", "liveness"]), 1, "{lines:#?}");
    let halted = ["INFO", "axis=\"x\"", "drive=drive 0", "halted"];
    assert_eq!(count(&lines, &halted), 1, "{lines:#?}");
    rig.net().stop_handle().stop_all(StopRequest::QUICK_STOP);
    rig.run_for(200 * MS);
    let lines = log.take();
    assert_eq!(
        count(&lines, &["WARN", "all axes are stopped", "QUICK_STOP"]),
        1,
        "{lines:#?}"
    );
    let left = ["axis=\"x\"", "from=OperationEnabled"];
    assert_eq!(count(&lines, &left), 1, "{lines:#?}");
    rig.shutdown();
}

#[test]
fn a_drive_that_falls_silent_is_logged_for_itself_and_for_each_of_its_axes() {
    let (line, mut rig) = two_drives();
    rig.run_for(20 * MS);
    let log = Log::begin();
    line.segment().unplug(1);
    rig.run_for(200 * MS);
    let lines = log.take();
    let lost = ["WARN", "drive=drive 1", "no longer answers"];
    assert_eq!(count(&lines, &lost), 1, "{lines:#?}");
    let axis = ["WARN", "axis=\"z\"", "counts as lost"];
    assert_eq!(count(&lines, &axis), 1, "{lines:#?}");
    line.segment().plug();
    rig.run_for(500 * MS);
    let lines = log.take();
    assert_eq!(
        count(&lines, &["INFO", "drive=drive 1", "answers again"]),
        1
    );
    drop(rig);
}

#[test]
fn a_cycle_in_which_frames_will_not_be_back_in_time_is_warned_of() {
    // 10 drives of 30 bytes: 16 + 16 + 12 + 300 + 26 + 14 bytes, 24 around them, 80 ns each, and 1 µs a drive: 42.6 µs, of which
    // 4/3 are 56.9.
    let start = |cycle_us: u64| {
        let segment = (0..10).fold(Segment::new(), |line, _| line.with(personality::generic()));
        let line = Line::new(segment);
        let builder = Network::builder()
            .link(line.wire())
            .cycle(Duration::from_micros(cycle_us));
        let builder = (0..10).fold(builder, |builder, position: u16| {
            let drive = DriveConfig::new(drives::generic()).axis(position.to_string());
            builder.drive(position, drive)
        });
        let log = Log::begin();
        let rig = Rig::start(builder).unwrap();
        let lines = log.take();
        rig.shutdown();
        count(
            &lines,
            &["WARN", "three quarters", "bytes=384", "takes=42.64µs"],
        )
    };
    assert_eq!((start(56), start(57)), (1, 0));
}

#[test]
fn a_sync0_that_comes_while_frames_are_on_their_way_is_warned_of_and_of_its_drive_alone() {
    // Two Sigma-7 and no more than 100 bytes in a frame: some 15 µs on the cable.
    let log = Log::begin();
    let line = Line::new(
        Segment::new()
            .with(personality::sigma7())
            .with(personality::sigma7()),
    );
    let drive = |axis: &str, shift: u64| {
        let clock = DistributedClock::new(0x0300).shift(Duration::from_micros(shift));
        DriveConfig::new(drives::sigma7()).axis(axis).dc(clock)
    };
    let builder = Network::builder()
        .link(line.wire())
        .drive(0, drive("late", 100))
        .drive(1, drive("soon", 3));
    Rig::start(builder).unwrap().shutdown();
    let lines = log.take();
    let warned = ["WARN", "SYNC0 comes while frames", "sync0_after=3µs"];
    assert_eq!(count(&lines, &warned[..2]), 1, "{lines:#?}");
    assert_eq!(
        count(&lines, &[&warned[..], &["drive 1 "]].concat()),
        1,
        "{lines:#?}"
    );
}
