//! A machine of the two axes of an AKD2G, in millimetres, and a gripper on an I/O terminal, under tokio. Both axes are homed, move together to
//! where a part is picked, and by blended moves to where it is placed. The gripper's sensor tells whether it has the part.
//!
//! Without arguments it runs on a simulated line in its own process. There a part is missing, and then a drive has a fault: the operator sees
//! why, and once that is mended the machine goes on. With `--interface eth0` it runs on the line there, part after part until Ctrl-C, and shows
//! its network: `servocrab panel --interface eth0` and the other commands of the tool look at it while it runs.
//!
//! Without a drive: make a veth pair, run `servocrab-sim --interface a --drive akd2g --drive io --stands-at 300000 --limit-switches 0..9000000`
//! on one end and this on the other. The inputs of that terminal follow its outputs: there is always a part.
//!
//! The machine's logic has tests of its own, in virtual time: `cargo test -p servocrab-attach --test pick_and_place`.

use std::{
    error::Error,
    fmt,
    io::Write,
    process::ExitCode,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use clap::Parser;
use servocrab::{
    Axis, AxisConfig, AxisError, BufferMode, DriveConfig, Failure, HomingMethod, HomingParameters,
    IoInput, IoOutput, Network, NetworkError, SetPoint,
    bus::{CycleClock, Expected, IoConfig, NetworkBuilder},
    drives,
    link::Wire,
    start_together,
    units::{Mm, Ratio, Scale},
};
use servocrab_attach::Attach;
use servocrab_sim::{
    Segment,
    ds402::Machine as Shaft,
    personality::{Servo, io_terminal},
};

/// Millimetres.
const PICK: (f64, f64) = (50.0, 12.5);
const PLACE: (f64, f64) = (120.0, 5.0);
/// Above this x the gripper is clear of what stands around the place.
const CLEAR: f64 = 90.0;
/// The simulated terminal of 16 outputs and 16 inputs, of no particular maker. A machine has its own vendor and product code here.
const TERMINAL: Expected = Expected::new(0, 0x494F_3136);
/// The output that closes the gripper, and the input of the sensor that sees a part between its jaws.
const CLOSE: u16 = 1 << 0;
const PART: u16 = 1 << 0;
/// How long the gripper may take.
const GRIP_WITHIN: Duration = Duration::from_millis(500);
/// mm/s and mm/s².
const FAST: SetPoint<Mm> = SetPoint::new()
    .velocity(200.0)
    .acceleration(2_000.0)
    .deceleration(2_000.0);

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// A gripper that does not do what it was told; it has had [`GRIP_WITHIN`].
#[derive(Debug, PartialEq, thiserror::Error)]
enum GripperError {
    #[error("the gripper was closed, and its sensor sees no part: put one to the pick")]
    NoPart,
    #[error("the gripper is to be open, and its sensor still sees a part: take it out")]
    PartStays,
}

struct Gripper {
    valve: IoOutput<u16>,
    sensor: IoInput<u16>,
    clock: CycleClock,
}

impl Gripper {
    fn new(net: &Network) -> Result<Self> {
        let terminal = net.io("gripper")?;
        Ok(Self {
            valve: terminal.output("Outputs")?,
            sensor: terminal.input("Inputs")?,
            clock: net.clock(),
        })
    }

    /// Ends once the part is held. Where there is none it is open again.
    async fn close(&self) -> Result<()> {
        self.valve.set(CLOSE);
        let held = self.sees(true).await?;
        if !held {
            self.valve.set(0);
            return Err(GripperError::NoPart.into());
        }
        Ok(())
    }

    /// Ends once the part is gone.
    async fn open(&self) -> Result<()> {
        self.valve.set(0);
        self.is_empty().await
    }

    async fn is_empty(&self) -> Result<()> {
        match self.sees(false).await? {
            true => Ok(()),
            false => Err(GripperError::PartStays.into()),
        }
    }

    /// Whether the sensor sees a part, or none, in time. An input that did not come says neither.
    async fn sees(&self, part: bool) -> Result<bool> {
        let seen = async {
            while self.sensor.get().map(|inputs| inputs & PART != 0) != Ok(part) {
                self.clock.next_cycle().await?;
            }
            Ok::<_, NetworkError>(())
        };
        let in_time = self.clock.timeout(GRIP_WITHIN, seen).await?.transpose()?;
        if in_time.is_none() {
            // A terminal that is silent is another error than a part that is missing.
            self.sensor.get()?;
        }
        Ok(in_time.is_some())
    }
}

/// What the program is about, whatever line it is wired to.
struct Machine {
    x: Axis<Mm>,
    y: Axis<Mm>,
    gripper: Gripper,
}

impl Machine {
    fn new(net: &Network) -> Result<Self> {
        Ok(Self {
            x: net.axis_in("x")?,
            y: net.axis_in("y")?,
            gripper: Gripper::new(net)?,
        })
    }

    /// Both axes at once, each to its negative limit switch.
    async fn home(&self) -> Result<()> {
        let homed = smol::future::zip(home(&self.x), home(&self.y)).await;
        homed.0?;
        homed.1?;
        Ok(())
    }

    /// One part. Where one axis fails the other one stops as well: by itself it would go on to the end of its move.
    async fn cycle(&self) -> Result<()> {
        let placed = self.part().await;
        if placed.is_err() {
            let stopped = smol::future::zip(self.x.stop(), self.y.stop()).await;
            for error in [stopped.0.err(), stopped.1.err()].into_iter().flatten() {
                say(format_args!("not stopped: {error}"));
            }
        }
        placed
    }

    async fn part(&self) -> Result<()> {
        // A part of a cycle that has failed is nowhere to be placed: somebody takes it out, and has the gripper opened.
        self.gripper.is_empty().await?;
        let on_x = self.x.profile_position().await?;
        let on_y = self.y.profile_position().await?;
        let there = [on_x.abs(PICK.0, FAST), on_y.abs(PICK.1, FAST)];
        for motion in start_together(there).await? {
            motion.done().await?;
        }
        self.gripper.close().await?;
        // Fast to where the way is clear, and on without a stop, slower, to the place.
        let clear = on_x.move_abs(CLEAR, FAST).await?;
        let slower = FAST.velocity(60.0).buffer_mode(BufferMode::Blending);
        let place = on_x.move_abs(PLACE.0, slower).await?;
        clear.done().await?;
        on_y.move_abs(PLACE.1, FAST).await?.done().await?;
        place.done().await?;
        self.gripper.open().await?;
        on_y.release().await?;
        Ok(on_x.release().await?)
    }
}

async fn home(axis: &Axis<Mm>) -> std::result::Result<(), AxisError> {
    axis.enable().await?;
    let homing = axis.homing().await?;
    let slowly = HomingParameters::new(HomingMethod::NEGATIVE_LIMIT)
        .speeds(50.0, 5.0)
        .acceleration(500.0)
        .offset(0.0);
    // An axis that has not found its switch by then is stopped.
    homing.home(slowly).within(Duration::from_secs(20)).await?;
    homing.release().await
}

/// A reader that has gone away (`| head`) ends no machine in mid-move, as the panic of `println!` would.
fn say(line: fmt::Arguments<'_>) {
    let _ = writeln!(std::io::stdout(), "{line}");
}

/// Carries parts with the two axes of an AKD2G at position 0, and a gripper on a terminal of 16 outputs and 16 inputs at position 1.
#[derive(Parser)]
struct Arguments {
    /// The network interface of the machine's line; without it, a line that is simulated in this process
    #[arg(long, value_name = "NAME")]
    interface: Option<String>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let run = async {
        if let Some(interface) = arguments.interface {
            return run_on(&interface).await;
        }
        let line = line();
        let wired = Arc::clone(&line);
        let wire = Wire::new(move |frame, now| lock(&wired).process(frame, now));
        let net = with_devices(Network::builder().link(wire))?.start().await?;
        demonstrate(&line, net).await
    };
    let done = tokio::runtime::Builder::new_current_thread()
        .build()
        .map_err(Into::into)
        .and_then(|runtime| runtime.block_on(run));
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("pick_and_place: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Part after part, until Ctrl-C or SIGTERM.
async fn run_on(interface: &str) -> Result<()> {
    let (sender, interrupt) = smol::channel::bounded::<()>(1);
    ctrlc::set_handler(move || {
        sender.close();
    })?;
    let net = with_devices(Network::builder().interface(interface))?
        .start()
        .await?;
    // From here on other programs of this user can look at the network, and stop its axes.
    let shown = servocrab_attach::serve(&net, Attach::new(interface))?;
    say(format_args!("shown at {}", shown.socket().display()));
    let machine = Machine::new(&net)?;
    let work = async {
        machine.home().await?;
        loop {
            machine.cycle().await?;
            say(format_args!("placed a part"));
        }
    };
    let interrupted = async {
        // Nothing is ever sent.
        let _ = interrupt.recv().await;
        Ok(())
    };
    let done = smol::future::or(interrupted, work).await;
    net.shutdown().await?;
    done
}

/// One part, a part that is missing, a fault, and another part.
async fn demonstrate(line: &Line, net: Network) -> Result<()> {
    let machine = Machine::new(&net)?;
    machine.home().await?;
    machine.cycle().await?;
    say(format_args!(
        "placed a part, at {:.2} mm and {:.2} mm",
        machine.x.status().position,
        machine.y.status().position
    ));

    lock(line).part_at_pick = false;
    match machine.cycle().await {
        Err(error) if error.downcast_ref() == Some(&GripperError::NoPart) => {
            say(format_args!("to the operator: {error}"));
        }
        done => return done,
    }
    lock(line).part_at_pick = true;

    break_encoder(line);
    let failed = machine.cycle().await;
    let Some(error) = failed
        .as_ref()
        .err()
        .and_then(|e| e.downcast_ref::<AxisError>())
    else {
        return failed;
    };
    say(format_args!("to the operator: {error}"));
    if !matches!(error.failure(), Some(Failure::Fault { .. })) {
        return failed;
    }
    // Somebody has mended it, and says so. The stop may have taken the torque of the other axis.
    mend_encoder(line);
    machine.x.reset_fault().await?;
    machine.x.enable().await?;
    machine.y.enable().await?;
    machine.cycle().await?;
    say(format_args!("and goes on"));
    net.shutdown().await?;
    Ok(())
}

fn with_devices(network: NetworkBuilder) -> Result<NetworkBuilder> {
    // 10 000 of the drive's counts are a millimetre.
    let mm = Scale::counts_per_unit(Ratio::new(10_000, 1)?);
    let drive = DriveConfig::new(drives::akd2g())
        .axis(AxisConfig::new("x").unit::<Mm>(mm))
        .axis(AxisConfig::new("y").unit::<Mm>(mm));
    Ok(network
        // Longer than a computer without real time keeps this thread waiting when it is busy.
        .watchdog(Duration::from_millis(500))
        .drive(0, drive)
        .io(1, IoConfig::new("gripper", TERMINAL)))
}

type Line = Arc<Mutex<Simulated>>;

/// The devices, and what the gripper and its sensor do between the outputs and the inputs of the terminal.
struct Simulated {
    segment: Segment,
    part_at_pick: bool,
    /// What the valve was told last, and when that was new.
    told: (bool, Duration),
}

impl Simulated {
    /// How long the jaws take.
    const STROKE: Duration = Duration::from_millis(40);

    fn process(&mut self, frame: &mut [u8], now: Duration) -> bool {
        if let Some(terminal) = self.segment.device_mut(1) {
            let close = terminal.outputs().first() == Some(&1);
            if close != self.told.0 {
                self.told = (close, now);
            }
            if now.saturating_sub(self.told.1) >= Self::STROKE {
                terminal.set_inputs(&[u8::from(close && self.part_at_pick)]);
            }
        }
        self.segment.process(frame, now)
    }
}

/// Each axis stands three centimetres from its switch.
fn line() -> Line {
    let shaft = Shaft {
        start: 300_000,
        negative_limit: Some(0),
        ..Shaft::default()
    };
    let drive = Servo::akd2g().change(move |drive| drive.machine = shaft.clone());
    Arc::new(Mutex::new(Simulated {
        segment: Segment::new().with(drive.build()).with(io_terminal()),
        part_at_pick: true,
        told: (false, Duration::ZERO),
    }))
}

fn lock(line: &Line) -> std::sync::MutexGuard<'_, Simulated> {
    line.lock().unwrap_or_else(PoisonError::into_inner)
}

fn break_encoder(line: &Line) {
    if let Some(axis) = lock(line).segment.axis_mut(0, 0) {
        axis.inject_lasting_fault(0x7305);
    }
}

fn mend_encoder(line: &Line) {
    if let Some(axis) = lock(line).segment.axis_mut(0, 0) {
        axis.clear_cause();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs what is asked of the machine in virtual time.
    fn with_machine<T>(line: &Line, asked: impl AsyncFnOnce(&Machine) -> Result<T>) -> Result<T> {
        let wired = Arc::clone(line);
        let latency = Duration::from_micros(20);
        let wire =
            Wire::in_virtual_time(latency, move |frame, now| lock(&wired).process(frame, now));
        let (starting, mut bus) = with_devices(Network::builder().link(wire))?.split()?;
        bus.run_until(async {
            let net = starting.network().await?;
            let machine = Machine::new(&net)?;
            machine.home().await?;
            let done = asked(&machine).await;
            net.shutdown().await?;
            done
        })
    }

    #[test]
    fn a_part_is_carried_from_the_pick_to_the_place_in_less_than_two_seconds() {
        let line = line();
        let took = with_machine(&line, async |machine| {
            let before = machine.gripper.clock.now();
            machine.cycle().await?;
            Ok(machine.gripper.clock.now() - before)
        });
        let took = took.unwrap();
        assert!(took < Duration::from_secs(2), "{took:?}");
        let ends = |axis| {
            let line = lock(&line);
            let ledger = line.segment.axis(0, axis).unwrap().ledger();
            ledger.iter().map(|move_| move_.value).collect::<Vec<_>>()
        };
        assert_eq!(ends(0), [500_000, 900_000, 1_200_000]);
        assert_eq!(ends(1), [125_000, 50_000]);
    }

    #[test]
    fn a_hundred_parts_do_not_drift() {
        let at = with_machine(&line(), async |machine| {
            for _ in 0..100 {
                machine.cycle().await?;
            }
            Ok((machine.x.status().position, machine.y.status().position))
        });
        let (x, y) = at.unwrap();
        assert!((x - PLACE.0).abs() < 0.01, "{x}");
        assert!((y - PLACE.1).abs() < 0.01, "{y}");
    }

    #[test]
    fn a_broken_encoder_is_told_and_a_reset_alone_does_not_help() {
        let line = line();
        let told = with_machine(&line, async |machine| {
            break_encoder(&line);
            let failed = machine.cycle().await.unwrap_err();
            let failed = failed.downcast::<AxisError>()?.to_string();
            let kept = machine.x.reset_fault().await.unwrap_err().to_string();
            mend_encoder(&line);
            machine.x.reset_fault().await?;
            machine.x.enable().await?;
            machine.y.enable().await?;
            machine.cycle().await?;
            Ok((failed, kept))
        });
        let (failed, kept) = told.unwrap();
        let why = "axis x (drive 0 \"AKD2G\"): the drive has a fault: 7305h (incremental encoder 1 fault)";
        assert_eq!(failed, why);
        assert_eq!(kept, why);
    }

    /// What the axes have been told since the line began.
    fn moves(line: &Line) -> usize {
        let line = lock(line);
        let axes = [0, 1].map(|axis| line.segment.axis(0, axis).unwrap().ledger().len());
        axes.iter().sum()
    }

    fn gripper_error(failed: Result<()>) -> GripperError {
        *failed.unwrap_err().downcast().unwrap()
    }

    #[test]
    fn nothing_is_carried_before_the_sensor_sees_the_part() {
        let line = line();
        let done = with_machine(&line, async |machine| {
            lock(&line).part_at_pick = false;
            let comes = async {
                while (machine.x.status().position - PICK.0).abs() > 0.01 {
                    machine.gripper.clock.next_cycle().await?;
                }
                machine
                    .gripper
                    .clock
                    .sleep(Duration::from_millis(300))
                    .await?;
                let before = moves(&line);
                lock(&line).part_at_pick = true;
                Ok::<_, NetworkError>(before)
            };
            let (placed, before) = smol::future::zip(machine.cycle(), comes).await;
            placed?;
            Ok(before?)
        });
        assert_eq!(done.unwrap(), 2, "the two moves to the pick");
        assert_eq!(moves(&line), 5);
    }

    #[test]
    fn a_part_that_is_missing_is_told_in_time_and_the_next_one_is_placed() {
        let line = line();
        let failed = with_machine(&line, async |machine| {
            lock(&line).part_at_pick = false;
            let before = machine.gripper.clock.now();
            let failed = machine.cycle().await;
            let took = machine.gripper.clock.now() - before;
            assert!(took < Duration::from_secs(2), "{took:?}");
            assert_eq!(moves(&line), 2, "the two moves to the pick");
            lock(&line).part_at_pick = true;
            // A gripper that was left closed would show it from now on.
            machine
                .gripper
                .clock
                .sleep(Duration::from_millis(50))
                .await?;
            machine.cycle().await?;
            Ok(gripper_error(failed))
        });
        assert_eq!(failed.unwrap(), GripperError::NoPart);
    }

    #[test]
    fn a_part_that_a_failed_cycle_has_left_in_the_gripper_is_taken_out_first() {
        let line = line();
        let refused = with_machine(&line, async |machine| {
            let breaks = async {
                while lock(&line).segment.device(1).unwrap().outputs()[0] & 1 == 0 {
                    machine.gripper.clock.next_cycle().await?;
                }
                machine
                    .gripper
                    .clock
                    .sleep(Duration::from_millis(100))
                    .await?;
                break_encoder(&line);
                Ok::<_, NetworkError>(())
            };
            let (failed, broken) = smol::future::zip(machine.cycle(), breaks).await;
            broken?;
            assert!(failed.is_err());
            mend_encoder(&line);
            machine.x.reset_fault().await?;
            machine.x.enable().await?;
            machine.y.enable().await?;
            let before = moves(&line);
            let refused = machine.cycle().await;
            assert_eq!(moves(&line), before);
            machine.gripper.open().await?;
            machine.cycle().await?;
            Ok(gripper_error(refused))
        });
        assert_eq!(refused.unwrap(), GripperError::PartStays);
    }

    #[test]
    fn a_terminal_without_power_is_another_error_than_a_missing_part() {
        let line = line();
        let failed = with_machine(&line, async |machine| {
            lock(&line).segment.device_mut(1).unwrap().power_off();
            machine
                .gripper
                .clock
                .sleep(Duration::from_millis(5))
                .await?;
            Ok(machine.gripper.close().await.unwrap_err().to_string())
        });
        let failed = failed.unwrap();
        assert!(failed.contains("not of the last cycle"), "{failed}");
    }

    #[test]
    fn an_axis_that_fails_stops_the_other_one() {
        let line = line();
        let y = with_machine(&line, async |machine| {
            let breaks = async {
                machine
                    .gripper
                    .clock
                    .sleep(Duration::from_millis(60))
                    .await?;
                break_encoder(&line);
                Ok::<_, Box<dyn Error>>(())
            };
            let (failed, broken) = smol::future::zip(machine.cycle(), breaks).await;
            broken?;
            assert!(failed.is_err());
            let stopped = machine.y.status().position;
            machine.gripper.clock.sleep(Duration::from_secs(1)).await?;
            Ok((stopped, machine.y.status().position))
        });
        let (stopped, after) = y.unwrap();
        assert!((after - stopped).abs() < 0.01, "{stopped} and then {after}");
        assert!(after < PICK.1 - 1.0, "{after}");
    }
}
