//! In this process only: the timing diagrams of the drives' documents, drawn from runs of this library on all simulated drives. Writes
//! `target/figures/*.svg`. Virtual time, so the pictures are the same on every machine; `docs/figures/` holds copies.

#[path = "../../tools/src/doctor/cable.rs"]
mod cable;
mod chart;
mod clocks;
mod gantry;
mod line;
#[path = "../picture/mod.rs"]
mod picture;
mod press;
mod probe;
mod scaling;
mod tool_changer;

use std::{
    error::Error,
    future::Future,
    path::Path,
    pin::pin,
    task::{Context, Poll, Waker},
    time::Duration,
};

use clap::Parser;
use picture::{Bit, Panel, Picture, Recorder, Step, Word, lock};
use servocrab::{
    AxisConfig, AxisError, BufferMode, DriveConfig, Failure, Move, Network, ProfilePosition,
    Referencing, SetPoint,
    axis::{AxisErrorKind, Tolerances},
    bus::BusLoop,
    drives::{self, DriveDescription},
    link::Wire,
};
use servocrab_sim::{Device, Segment, personality};

const FOLDER: &str = "target/figures";
/// What is shown before the first command.
const LEAD_S: f64 = 0.010;
/// Where a frame's first datagram behind the tag has its command, and the command of process data.
const COMMAND: usize = 32;
const LRW: u8 = 12;
/// Virtual time in which every run must be over.
const LIMIT: Duration = Duration::from_secs(60);

const BIT_4: Bit = ("new set-point (6040h bit 4)", Word::Control(4));
const BIT_5: Bit = ("change immediately (6040h bit 5)", Word::Control(5));
const BIT_9: Bit = ("blend (6040h bit 9)", Word::Control(9));
const BIT_10: Bit = ("target reached (6041h bit 10)", Word::Status(10));
const BIT_12: Bit = ("acknowledge (6041h bit 12)", Word::Status(12));

/// Moves of a tenth of a second, so that the handshake's few milliseconds can be seen beside them.
const SLOW: SetPoint = SetPoint::new()
    .velocity(200_000)
    .acceleration(10_000_000)
    .deceleration(10_000_000);
const FAST: SetPoint = SLOW.velocity(400_000);

type Result<T = ()> = std::result::Result<T, Box<dyn Error>>;

/// Runs in this process only, on the simulated drives, and takes no arguments.
#[derive(Parser)]
struct Arguments {}

fn main() -> Result {
    Arguments::parse();
    single_set_point()?;
    set_of_set_points()?;
    akd2g_bit_5()?;
    akd2g_bit_9()?;
    ax2000_handshake()?;
    clocks::phase_after_power_on()?;
    gantry::one_side_jams()?;
    press::contact()?;
    probe::edges()?;
    scaling::shortest_cycle()?;
    tool_changer::comes_and_goes()
}

/// The 2010h document's first figure.
fn single_set_point() -> Result {
    let panel = run("bit 5 = 1", pp2010(), |stage| {
        let first = stage.moves("first set-point: 30 000", 30_000, SLOW)?;
        stage.pause(70);
        let second = stage.moves("second, at once: 60 000, twice as fast", 60_000, FAST)?;
        stage.ends(&[first, second])
    })?;
    draw(
        "pp2010-single-set-point",
        "Drive with 2010h, single set-point: the second is processed at once",
        &[BIT_4, BIT_5, BIT_12, BIT_10],
        &[panel],
    )
}

/// The 2010h document's second figure.
fn set_of_set_points() -> Result {
    let panel = run("bit 5 = 0", pp2010(), |stage| {
        let slow = SLOW.buffer_mode(BufferMode::Buffered);
        let fast = FAST.buffer_mode(BufferMode::Buffered);
        let first = stage.moves("first set-point: 16 000", 16_000, slow)?;
        stage.pause(15);
        let second = stage.moves(
            "second: 40 000, twice as fast; both places are busy",
            40_000,
            fast,
        )?;
        stage.pause(15);
        let third = stage.moves("third: 50 000; it waits until one is free", 50_000, slow)?;
        stage.ends(&[first, second, third])
    })?;
    draw(
        "pp2010-set-of-set-points",
        "Drive with 2010h, set of set-points: each is processed after the one before",
        &[BIT_4, BIT_5, BIT_12, BIT_10],
        &[panel],
    )
}

/// Two moves on an AKD2G, the second while the first runs.
fn akd2g_pair(name: &str, first: BufferMode, second: BufferMode) -> Result<Panel> {
    run(name, akd2g(), |stage| {
        let first = stage.moves("first move: 30 000", 30_000, SLOW.buffer_mode(first))?;
        stage.pause(70);
        let second = stage.moves(
            "second move: 60 000, twice as fast",
            60_000,
            FAST.buffer_mode(second),
        )?;
        stage.ends(&[first, second])
    })
}

/// The AKD2G's pair for bit 5.
fn akd2g_bit_5() -> Result {
    let panels = [
        akd2g_pair("bit 5 = 0", BufferMode::Buffered, BufferMode::Buffered)?,
        akd2g_pair("bit 5 = 1", BufferMode::Aborting, BufferMode::Aborting)?,
    ];
    let title = "AKD2G, bit 5: start after the current move, or immediately";
    let bits = [BIT_4, BIT_5, BIT_9, BIT_12, BIT_10];
    draw("akd2g-bit-5", title, &bits, &panels)
}

/// The AKD2G's pair for bit 9.
fn akd2g_bit_9() -> Result {
    let panels = [
        akd2g_pair("bit 9 = 0", BufferMode::Buffered, BufferMode::Buffered)?,
        akd2g_pair("bit 9 = 1", BufferMode::Buffered, BufferMode::Blending)?,
    ];
    let title = "AKD2G, bit 9 (bit 5 = 0): start from standstill, or blend into the next move";
    let bits = [BIT_4, BIT_5, BIT_9, BIT_12, BIT_10];
    draw("akd2g-bit-9", title, &bits, &panels)
}

/// The AX2000's figure of the handshake, with its numbers.
fn ax2000_handshake() -> Result {
    let mut panel = run("set of set-points", ax2000(), |stage| {
        let alone = SLOW.buffer_mode(BufferMode::Buffered);
        let first = stage.moves("move_abs(10 000)", 10_000, alone)?;
        let next = SLOW.buffer_mode(BufferMode::Blending);
        let second = stage.moves("blend into move_abs(20 000)", 20_000, next)?;
        stage.ends(&[first, second])
    })?;
    panel.rows.retain(|row| row.time_s < LEAD_S + 0.020);
    panel.steps = six_steps(&panel).ok_or("the handshake is incomplete")?;
    let picture = Picture {
        title: "AX2000: the handshake of a set-point in six steps",
        width: 1000,
        bits: &[
            ("data (607Ah)", Word::Target),
            ("new_setpoint (6040h bit 4)", Word::Control(4)),
            ("change_set_immediately (6040h bit 5)", Word::Control(5)),
            ("setpoint_acknowledge (6041h bit 12)", Word::Status(12)),
        ],
        curves: false,
        states: false,
        command_lines: 3,
        milliseconds: true,
        tail_s: 0.001,
    };
    write("ax2000-handshake", &picture, &[panel])
}

/// Data are there (1), bit 4 rises (2), bit 12 rises (3), bit 4 falls (4), bit 12 falls (5). Bit 5 is set (6): a set-point that
/// continues a set; the one before has it at 0.
fn six_steps(panel: &Panel) -> Option<Vec<Step>> {
    const DATA: usize = 0;
    const NEW_SET_POINT: usize = 1;
    const CHANGE_IMMEDIATELY: usize = 2;
    const ACKNOWLEDGE: usize = 3;
    let edge = |from: usize, word: fn(&picture::Row) -> u16, bit: u16, high: bool| {
        let rows = panel.rows.iter().enumerate().skip(from);
        rows.into_iter()
            .find(|(_, row)| (word(row) >> bit & 1 == 1) == high)
            .map(|(at, _)| at)
    };
    let control = |row: &picture::Row| row.controlword;
    let status = |row: &picture::Row| row.statusword;
    let rise = edge(0, control, 4, true)?;
    let acknowledged = edge(rise, status, 12, true)?;
    let fall = edge(acknowledged, control, 4, false)?;
    let free = edge(fall, status, 12, false)?;
    let set = edge(0, control, 5, true)?;
    let target = panel.rows.get(rise)?.target;
    let data = panel.rows.iter().position(|row| row.target == target)?;
    let steps = [
        (data, DATA),
        (rise, NEW_SET_POINT),
        (acknowledged, ACKNOWLEDGE),
        (fall, NEW_SET_POINT),
        (free, ACKNOWLEDGE),
        (set, CHANGE_IMMEDIATELY),
    ];
    (1..)
        .zip(steps)
        .map(|(number, (row, trace))| {
            Some(Step {
                time_s: panel.rows.get(row)?.time_s,
                trace,
                number,
            })
        })
        .collect()
}

fn write(name: &str, picture: &Picture<'_>, panels: &[Panel]) -> Result {
    let file = Path::new(FOLDER).join(name).with_extension("svg");
    picture.draw(&file, panels)?;
    println!("{}", file.display());
    Ok(())
}

fn draw(name: &str, title: &str, bits: &[Bit], panels: &[Panel]) -> Result {
    let picture = Picture {
        title,
        width: 1000,
        bits,
        curves: true,
        states: false,
        command_lines: 3,
        milliseconds: true,
        tail_s: 0.0,
    };
    write(name, &picture, panels)
}

/// A simulated drive and what the library knows of it.
struct Drive {
    device: Device,
    description: DriveDescription,
}

fn akd2g() -> Drive {
    let mut description = drives::akd2g();
    description.axes.truncate(1);
    Drive {
        device: personality::akd2g(),
        description,
    }
}

fn pp2010() -> Drive {
    Drive {
        device: personality::pp2010(),
        description: drives::pp2010(),
    }
}

fn ax2000() -> Drive {
    Drive {
        device: personality::ax2000(),
        description: drives::ax2000(),
    }
}

/// A network with one axis in virtual time, and what it does.
struct Stage {
    bus: BusLoop,
    profile_position: ProfilePosition,
    recorder: Recorder,
}

impl Stage {
    /// Starts a move; it is acknowledged on return.
    fn moves(
        &mut self,
        what: &str,
        target: i32,
        set_point: SetPoint,
    ) -> std::result::Result<Move, AxisError> {
        self.recorder.mark(0, what);
        let motion = self.profile_position.move_abs(target, set_point);
        turn_until(&mut self.bus, motion)
    }

    /// Waits for all outcomes; that a move is superseded is one of them.
    fn ends(&mut self, moves: &[Move]) -> Result {
        for motion in moves {
            match turn_until(&mut self.bus, motion.done()) {
                Ok(_) => {}
                Err(error) if is_superseded(&error) => {}
                Err(error) => return Err(error.into()),
            }
        }
        self.pause(20);
        Ok(())
    }

    fn pause(&mut self, milliseconds: u64) {
        let end = self.bus.now() + Duration::from_millis(milliseconds);
        while self.bus.now() < end && self.bus.turn() {}
    }
}

/// Brings a drive up, enables its axis, and records what `story` does with it.
fn run(name: &str, drive: Drive, story: impl FnOnce(&mut Stage) -> Result) -> Result<Panel> {
    let recorder = Recorder::new(&[name]);
    let mut segment = Segment::new().with(drive.device);
    let on_the_wire = recorder.clone();
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame, now| {
        let is_process_data = frame.get(COMMAND) == Some(&LRW);
        let comes_back = segment.process(frame, now);
        if let Some(row) = seen(&segment, now).filter(|_| is_process_data) {
            on_the_wire.row(0, row);
        }
        comes_back
    });
    // Short moves, on drives that go on to the next one while the axis still follows: what is close is to be seen as there.
    let axis = AxisConfig::new("x")
        .referencing(Referencing::AbsoluteEncoder)
        .tolerances(Tolerances {
            position: 200,
            settle: Duration::from_millis(20),
        });
    let config = DriveConfig::new(drive.description).axis(axis);
    let builder = Network::builder()
        .link(wire)
        .cycle(Duration::from_millis(1))
        .drive(0, config);
    let (starting, mut bus) = builder.split()?;
    let net = turn_until(&mut bus, starting.network())?;
    let axis = net.axis("x")?;
    turn_until(&mut bus, axis.enable())?;
    let profile_position = turn_until(&mut bus, axis.profile_position())?;
    let mut stage = Stage {
        bus,
        profile_position,
        recorder,
    };
    stage.pause(100);
    story(&mut stage)?;
    let panel = stage.recorder.panels(LEAD_S).pop();
    panel.ok_or_else(|| "nothing was recorded".into())
}

fn is_superseded(error: &AxisError) -> bool {
    matches!(error.kind, AxisErrorKind::Failed(Failure::Superseded))
}

/// What a frame carried: the outputs that it left, and the axis as its inputs showed it.
fn seen(segment: &Segment, now: Duration) -> Option<picture::Row> {
    // The mapping begins with 6040h, 6060h and 607Ah on all of these drives.
    let &[c0, c1, _mode, t0, t1, t2, t3, ..] = segment.last_outputs(0) else {
        return None;
    };
    Some(picture::Row {
        controlword: u16::from_le_bytes([c0, c1]),
        target: i32::from_le_bytes([t0, t1, t2, t3]).into(),
        ..picture::Row::of_model(now, segment.axis(0, 0)?)
    })
}

/// Turns the loop until the future is ready.
fn turn_until<T>(bus: &mut BusLoop, future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
        let goes_on = bus.turn();
        assert!(goes_on && bus.now() < LIMIT, "the run does not end");
    }
}
