//! The main job, in this process only: a simulated AKD2G with two axes is configured over CoE, and both move in Profile
//! Position mode. Prints what happens as it happens, and draws it into `target/quickstart.svg`.
//!
//! On a real link, `.interface("eth0")` takes the place of `.link(…)`; the rest stays.

#[macro_use]
#[path = "../common/say.rs"]
mod say;

#[path = "../picture/mod.rs"]
mod picture;

use std::{
    error::Error,
    path::Path,
    process::ExitCode,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use clap::Parser;
use picture::{Bit, Picture, Recorder, Word, lock};
use servocrab::{
    Axis, AxisConfig, AxisError, BufferMode, DriveConfig, Failure, Move, Network, Outcome,
    ProfilePosition, Referencing, SetPoint, axis::AxisErrorKind, coe::obj, drives, link::Wire,
    parameters::StartUpWrite, start_together,
};
use servocrab_sim::{Segment, personality};

const PICTURE: &str = "target/quickstart.svg";
const BITS: [Bit; 6] = [
    ("new set-point (6040h bit 4)", Word::Control(4)),
    ("acknowledge (6041h bit 12)", Word::Status(12)),
    ("target reached (6041h bit 10)", Word::Status(10)),
    ("halt (6040h bit 8)", Word::Control(8)),
    ("quick stop, active low (6040h bit 2)", Word::Control(2)),
    ("fault (6041h bit 3)", Word::Status(3)),
];

/// Runs in this process only, on a simulated AKD2G, and takes no arguments.
#[derive(Parser)]
struct Arguments {}

fn main() -> ExitCode {
    Arguments::parse();
    match smol::block_on(run()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("quickstart: {error}");
            ExitCode::FAILURE
        }
    }
}

async fn run() -> Result<(), Box<dyn Error>> {
    let recorder = Recorder::new(&["axis x", "axis y"]);
    let segment = Arc::new(Mutex::new(Segment::new().with(personality::akd2g())));
    lock(&segment).observe(recorder.observer());
    let wired = Arc::clone(&segment);
    let wire = Wire::new(move |frame, now| lock(&wired).process(frame, now));

    say!("Bringing up the segment: CoE configuration, PDO mapping, watchdog, OP.");
    // Besides the mapping, the drive gets its quick stop ramp of both axes over CoE, counts/s².
    let ramp = 150_000;
    let drive = DriveConfig::new(drives::akd2g())
        // The simulated motors have absolute encoders; others are homed first, see examples/home_and_jog.rs.
        .axis(AxisConfig::new("x").referencing(Referencing::AbsoluteEncoder))
        .axis(AxisConfig::new("y").referencing(Referencing::AbsoluteEncoder))
        .start_up(StartUpWrite::new(obj::QUICK_STOP_DECELERATION, ramp))
        .start_up(StartUpWrite::new(
            obj::QUICK_STOP_DECELERATION.axis(2),
            ramp,
        ));
    let net = Network::builder()
        .link(wire)
        .cycle(Duration::from_millis(1))
        .drive(0, drive)
        .start()
        .await?;
    let story = Story {
        recorder: recorder.clone(),
        begin: Instant::now(),
    };
    let (x, y) = (net.axis("x")?, net.axis("y")?);

    story.says(X, "enable");
    x.enable().await?;
    story.says(Y, "enable");
    y.enable().await?;
    let (on_x, on_y) = (x.profile_position().await?, y.profile_position().await?);

    moves(&story, &on_x).await?;
    start_both(&story, &on_x, &on_y).await?;
    halt_and_resume(&story, &x, &on_x).await?;
    quick_stop(&story, &y, &on_y).await?;
    fault(&story, &segment, &x, &on_x).await?;

    on_x.release().await?;
    on_y.release().await?;
    story.says(X, "disable");
    x.disable().await?;
    story.says(Y, "disable");
    y.disable().await?;
    say!(
        "{:7.3} s  x is in {}, y is in {}",
        story.now(),
        x.status().state,
        y.status().state
    );
    net.shutdown().await?;

    let picture = Picture {
        title: "Two axes of a simulated AKD2G in Profile Position mode",
        width: 1500,
        bits: &BITS,
        curves: true,
        states: true,
        command_lines: 5,
        milliseconds: false,
        tail_s: 0.5,
    };
    picture.draw(Path::new(PICTURE), &recorder.panels(0.05))?;
    say!("The whole story as a picture: {PICTURE}");
    Ok(())
}

/// Absolute and relative, changed on the fly, blended.
async fn moves(story: &Story, x: &ProfilePosition) -> Result<(), AxisError> {
    let fast = SetPoint::new()
        .velocity(40_000)
        .acceleration(200_000)
        .deceleration(200_000);
    story.says(X, "move_abs(10 000)");
    story.ends(X, &x.move_abs(10_000, fast).await?).await?;

    story.says(X, "move_rel(-4 000)");
    story.ends(X, &x.move_rel(-4_000, fast).await?).await?;

    story.says(X, "move_abs(20 000)");
    let first = x.move_abs(20_000, fast).await?;
    pause(250).await;
    story.says(X, "instead, at once: move_abs(0)");
    let second = x.move_abs(0, fast).await?;
    story.ends(X, &first).await?;
    story.ends(X, &second).await?;

    story.says(X, "move_abs(8 000)");
    let first = x.move_abs(8_000, fast).await?;
    story.says(X, "blend into move_abs(16 000), slower");
    let second = x
        .move_abs(
            16_000,
            fast.velocity(15_000).buffer_mode(BufferMode::Blending),
        )
        .await?;
    story.ends(X, &first).await?;
    story.ends(X, &second).await
}

/// Bit 4 of both axes rises in one frame.
async fn start_both(
    story: &Story,
    x: &ProfilePosition,
    y: &ProfilePosition,
) -> Result<(), Box<dyn Error>> {
    let gentle = SetPoint::new()
        .velocity(30_000)
        .acceleration(100_000)
        .deceleration(100_000);
    story.says(X, "together with y: abs(0)");
    story.says(Y, "together with x: abs(12 000)");
    let both = start_together([x.abs(0, gentle), y.abs(12_000, gentle)]).await?;
    for (axis, motion) in both.iter().enumerate() {
        story.ends(axis, motion).await?;
    }
    Ok(())
}

async fn halt_and_resume(story: &Story, axis: &Axis, x: &ProfilePosition) -> Result<(), AxisError> {
    story.says(X, "move_abs(15 000), slower");
    let motion = x.move_abs(15_000, BRISK.velocity(25_000)).await?;
    pause(250).await;
    story.says(X, "halt");
    axis.halt().await?;
    story.ends(X, &motion).await?;
    pause(150).await;
    story.says(X, "resume");
    axis.resume().await?;
    let outcome = motion.done_through_halt().await?;
    story.tells(X, &format!("{outcome:?}"));
    Ok(())
}

async fn quick_stop(story: &Story, axis: &Axis, y: &ProfilePosition) -> Result<(), AxisError> {
    story.says(Y, "move_abs(-20 000)");
    let motion = y.move_abs(-20_000, BRISK).await?;
    pause(250).await;
    story.says(Y, "quick stop");
    let state = axis.quick_stop().await?;
    story.tells(Y, &format!("stands, the drive is in {state}"));
    story.ends(Y, &motion).await?;
    story.says(Y, "enable again: nothing moves");
    axis.enable().await?;
    pause(150).await;
    story.says(Y, "move_abs(0)");
    story.ends(Y, &y.move_abs(0, BRISK).await?).await
}

async fn fault(
    story: &Story,
    segment: &Arc<Mutex<Segment>>,
    axis: &Axis,
    x: &ProfilePosition,
) -> Result<(), Box<dyn Error>> {
    story.says(X, "move_abs(0)");
    let motion = x.move_abs(0, BRISK).await?;
    pause(200).await;
    story.says(X, "(its encoder fails)");
    lock(segment)
        .axis_mut(0, 0)
        .ok_or("the segment has an axis x")?
        .inject_fault(0x7305);
    story.ends(X, &motion).await?;
    pause(200).await;
    story.says(X, "reset the fault");
    axis.reset_fault().await?;
    story.tells(X, &format!("the drive is in {}", axis.status().state));
    pause(100).await;
    story.says(X, "enable");
    axis.enable().await?;
    story.says(X, "move_abs(0)");
    story.ends(X, &x.move_abs(0, BRISK).await?).await?;
    Ok(())
}

/// Ramps that can be seen in the picture.
const BRISK: SetPoint = SetPoint::new()
    .velocity(40_000)
    .acceleration(300_000)
    .deceleration(300_000);

const X: usize = 0;
const Y: usize = 1;
const NAMES: [&str; 2] = ["x", "y"];

/// Prints what happens, and remembers it for the picture.
struct Story {
    recorder: Recorder,
    begin: Instant,
}

impl Story {
    fn now(&self) -> f64 {
        self.begin.elapsed().as_secs_f64()
    }

    /// A command is about to be given.
    fn says(&self, axis: usize, what: &str) {
        say!("{:7.3} s  {}: {what}", self.now(), NAMES[axis]);
        self.recorder.mark(axis, what);
    }

    /// Something was reported.
    fn tells(&self, axis: usize, what: &str) {
        say!("{:7.3} s  {}:   → {what}", self.now(), NAMES[axis]);
    }

    /// Waits for a move's one outcome and prints it; that a move ends otherwise is part of the example.
    async fn ends(&self, axis: usize, motion: &Move) -> Result<(), AxisError> {
        match motion.done().await {
            Ok(Outcome::Reached { position }) => {
                self.tells(axis, &format!("reached, at {position}"));
            }
            Ok(Outcome::Passed { position }) => {
                self.tells(axis, &format!("passed into the next move, at {position}"));
            }
            Ok(other) => self.tells(axis, &other.to_string()),
            Err(error) => match &error.kind {
                AxisErrorKind::Failed(
                    Failure::Superseded
                    | Failure::Halted { .. }
                    | Failure::QuickStopped { .. }
                    | Failure::Fault { .. },
                ) => self.tells(axis, &error.to_string()),
                _ => return Err(error),
            },
        }
        Ok(())
    }
}

async fn pause(milliseconds: u64) {
    smol::Timer::after(Duration::from_millis(milliseconds)).await;
}
