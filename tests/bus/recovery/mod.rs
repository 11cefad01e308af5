//! Devices that are led back into OP, while the others go on as if nothing were.

mod anew;
mod broken_off;
mod fallen;
mod io;
mod replacement;
mod where_it_is;

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use servocrab::{
    Axis, AxisError, BufferMode, DriveConfig, Failure, HomingMethod, HomingParameters, Move,
    Network, NetworkError, Outcome, ProfilePosition, SetPoint,
    bus::{DevicePlace, NetworkBuilder, NetworkEvent, Recovered},
    drives::{self, DriveDescription},
    pdo_map::{Entry, FixedPdo},
};
use servocrab_sim::{AlState, Device, Segment, ds402::State, personality, personality::Servo};

use crate::rig::{Line, Rig, akd2g, unhomed};

const MS: Duration = Duration::from_millis(1);
/// Where the drive that falls stands in the line, and among its drives.
const MIDDLE: usize = 1;

/// Each drive that is simulated, with the names of its axes.
fn kinds() -> Vec<(Device, DriveDescription, &'static [&'static str])> {
    vec![
        (personality::generic(), drives::generic(), &["z"]),
        (personality::akd2g(), drives::akd2g(), &["z", "w"]),
        (personality::ax2000(), drives::ax2000(), &["z"]),
        (personality::sigma7(), drives::sigma7(), &["z"]),
        (personality::pp2010(), drives::pp2010(), &["z"]),
    ]
}

/// A drive that has 6081h, 6083h and 6084h in no PDO.
fn with_parameters_by_sdo() -> (Device, DriveDescription) {
    let entry = |index, bits| Entry::new(index, 0, bits);
    let mut description = drives::generic();
    description.axes[0].rx_pdos.clear();
    description.axes[0].tx_pdos.clear();
    description.fixed_pdos = vec![
        FixedPdo::new(
            0x1701,
            [entry(0x6040, 16), entry(0x6060, 8), entry(0x607A, 32)],
        ),
        FixedPdo::new(
            0x1B01,
            [entry(0x6041, 16), entry(0x6061, 8), entry(0x6064, 32)],
        ),
    ];
    (servo_with_parameters_by_sdo().build(), description)
}

fn servo_with_parameters_by_sdo() -> Servo {
    Servo::generic()
        .with_fixed_pdo(0x1701, &[(0x6040, 0, 16), (0x6060, 0, 8), (0x607A, 0, 32)])
        .with_fixed_pdo(0x1B01, &[(0x6041, 0, 16), (0x6061, 0, 8), (0x6064, 0, 32)])
        .fixed_mapping()
}

fn set_point() -> SetPoint {
    SetPoint::new()
        .velocity(10_000)
        .acceleration(100_000)
        .deceleration(100_000)
}

/// Three drives: one with axes `x` and `y` before, and one with axis `a` behind the one that it is about.
struct Yard {
    line: Line,
    rig: Rig,
    watched: Watched,
    /// Of `x`, on its way all the time.
    moving: Option<(ProfilePosition, Move)>,
    undisturbed: Vec<(u16, u64, u64)>,
}

impl Yard {
    fn new(middle: Device, config: DriveConfig) -> Self {
        Self::with(middle, config, |line| Network::builder().link(line.wire()))
    }

    fn with(
        middle: Device,
        config: DriveConfig,
        builder: impl FnOnce(&Line) -> NetworkBuilder,
    ) -> Self {
        Self::placed(middle, 1.into(), config, builder)
    }

    fn placed(
        middle: Device,
        place: DevicePlace,
        config: DriveConfig,
        builder: impl FnOnce(&Line) -> NetworkBuilder,
    ) -> Self {
        let mut segment = Segment::new()
            .with(personality::akd2g())
            .with(middle)
            .with(personality::akd2g());
        let watched = Watched::on(&mut segment);
        let line = Line::new(segment);
        let rear = unhomed(drives::akd2g(), &["a"]);
        let builder = builder(&line)
            .drive(0, akd2g())
            .drive(place, config)
            .drive(2, rear);
        let mut rig = Rig::start(builder).unwrap();
        let x = rig.net().axis("x").unwrap();
        let moving = rig.until(async {
            x.enable().await.unwrap();
            let mode = x.profile_position().await.unwrap();
            let far = mode.move_abs(40_000, set_point()).await.unwrap();
            (mode, far)
        });
        Self {
            line,
            rig,
            watched,
            moving: Some(moving),
            undisturbed: Vec::new(),
        }
    }

    fn axis(&self, name: &str) -> Axis {
        self.rig.net().axis(name).unwrap()
    }

    /// Enables the axis and starts a move that does not end soon.
    fn start(&mut self, axis: &str) -> (ProfilePosition, Move) {
        let axis = self.axis(axis);
        let (mode, motion) = self.rig.until(async {
            axis.enable().await.unwrap();
            let mode = axis.profile_position().await.unwrap();
            let far = set_point().buffer_mode(BufferMode::Buffered);
            let motion = mode.move_abs(600_000, far).await.unwrap();
            (mode, motion)
        });
        self.rig.run_for(100 * MS);
        let before = axis.status().position;
        self.rig.run_for(20 * MS);
        assert_ne!(axis.status().position, before, "it moves");
        (mode, motion)
    }

    /// Takes the place where it stands for this position.
    fn is_homed_here(&mut self, axis: &str, position: i32) -> Axis {
        let axis = self.axis(axis);
        self.rig.until(async {
            axis.enable().await.unwrap();
            let homing = axis.homing().await.unwrap();
            let here = HomingParameters::new(HomingMethod::CURRENT_POSITION).offset(position);
            homing.home(here).await.unwrap();
        });
        assert!(axis.status().referenced);
        axis
    }

    fn falls(&mut self, code: u16) {
        fall(&self.line, code);
        self.rig.run_for(700 * MS);
    }

    /// Its power is off for this long; what stands behind it is cut off meanwhile.
    fn loses_power(&mut self, off: Duration) {
        self.line.segment().device_mut(MIDDLE).unwrap().power_off();
        self.rig.run_for(off);
        self.has_power_again();
    }

    fn has_power_again(&mut self) {
        let now = self.rig.bus.now();
        let mut segment = self.line.segment();
        segment.device_mut(MIDDLE).unwrap().power_on(now);
        drop(segment);
        self.rig.run_for(100 * MS);
    }

    fn state(&self, position: usize) -> AlState {
        self.line.segment().device(position).unwrap().al_state()
    }

    /// From now on the axes of the drive in the middle must do nothing, and the others must not notice.
    fn nothing_may_happen(&mut self) {
        self.watched.arm();
        self.undisturbed = self.counters();
    }

    fn recover(&mut self, position: u16) -> Result<Recovered, NetworkError> {
        let net = self.rig.net.take().unwrap();
        let recovered = self.rig.until(net.recover(position));
        self.rig.net = Some(net);
        recovered
    }

    /// Stale and undelivered cycles of the first drive, and wrong working counters.
    fn counters(&self) -> Vec<(u16, u64, u64)> {
        let net = self.rig.net();
        let drives = net.drive_statistics();
        let counted = drives.iter().filter(|drive| drive.drive.position == 0);
        let mut all: Vec<_> = counted
            .map(|drive| {
                (
                    drive.drive.position,
                    drive.stale_cycles,
                    drive.undelivered_cycles,
                )
            })
            .collect();
        all.push((u16::MAX, net.statistics().wrong_working_counters, 0));
        all
    }

    /// That nothing has happened since.
    fn nothing_has_happened(&mut self) {
        self.rig.run_for(200 * MS);
        assert_eq!(self.watched.seen(), Vec::<String>::new());
        assert_eq!(self.undisturbed, self.counters(), "of the other drives");
        self.watched.disarm();
    }

    /// The axis is switched off, there, and does what it is told once it has been enabled, and not before.
    fn works_again(&mut self, name: &str) {
        let axis = self.axis(name);
        let status = axis.status();
        assert!(!status.lost && status.answered, "{name}: {status:?}");
        assert!(
            !status.has_set_point && !status.halted,
            "{name}: {status:?}"
        );
        let number = usize::from(name == "w");
        let before = {
            let segment = self.line.segment();
            let axis = segment.axis(MIDDLE, number).unwrap();
            (axis.ledger().len(), axis.mechanical_position())
        };
        self.rig.until(async {
            if axis.status().state.is_fault() {
                axis.reset_fault().await.unwrap();
            }
            axis.enable().await.unwrap();
        });
        self.rig.run_for(200 * MS);
        {
            let segment = self.line.segment();
            let axis = segment.axis(MIDDLE, number).unwrap();
            assert_eq!(axis.state(), State::OperationEnabled);
            assert_eq!(
                axis.ledger().len(),
                before.0,
                "{name}: nothing is asked for"
            );
            let off = (axis.mechanical_position() - before.1).abs();
            assert!(off <= 10, "{name}: moved {off} by being enabled");
        }
        let status = axis.status();
        let target = status.position + 3_000;
        let outcome = self.rig.until(async {
            let mode = axis.profile_position().await.unwrap();
            let near = set_point().buffer_mode(BufferMode::Buffered);
            let motion = mode.move_abs(target, near).await.unwrap();
            motion.done().await.unwrap()
        });
        let Outcome::Reached { position } = outcome else {
            panic!("{name}: {outcome:?}");
        };
        assert!((position - target).abs() < 20, "{name}: {position}");
        let segment = self.line.segment();
        let ledger = segment.axis(MIDDLE, number).unwrap().ledger();
        assert_eq!(ledger.len(), before.0 + 1, "{name}: one set-point");
        assert_eq!(ledger[before.0].value, target);
    }

    /// The axis that moved all the while arrives.
    fn ends(mut self) {
        let (mode, moving) = self.moving.take().unwrap();
        let outcome = self.rig.until(moving.done()).unwrap();
        assert!(
            matches!(outcome, Outcome::Reached { position } if (position - 40_000).abs() <= 10),
            "{outcome:?}"
        );
        drop(mode);
        self.rig.shutdown();
    }
}

/// The drive in the middle leaves OP.
fn fall(line: &Line, code: u16) {
    let mut segment = line.segment();
    segment.device_mut(MIDDLE).unwrap().fall_to_safe_op(code);
}

/// Whether a move ended as one whose drive was lost, or has stopped it when it fell.
fn is_over(outcome: &Result<Outcome, AxisError>) -> bool {
    let failure = outcome.as_ref().err().and_then(AxisError::failure);
    matches!(
        failure,
        Some(
            Failure::BusLost { .. }
                | Failure::LeftOp { .. }
                | Failure::QuickStopped { .. }
                | Failure::Fault { .. }
        )
    )
}

fn events(rig: &Rig) -> Vec<NetworkEvent> {
    let events = rig.net().events();
    std::iter::from_fn(|| events.try_next()).collect()
}

/// What the axes of the drive in the middle do while they are to do nothing.
#[derive(Clone, Default)]
struct Watched(Arc<Mutex<Seen>>);

#[derive(Default)]
struct Seen {
    armed: bool,
    /// Of each axis, where it stood.
    stood: Vec<(usize, i64)>,
    wrong: Vec<String>,
}

impl Watched {
    fn on(segment: &mut Segment) -> Self {
        let this = Self::default();
        let seen = Arc::clone(&this.0);
        segment.observe(move |record| {
            let mut seen = seen.lock().unwrap();
            if record.drive != MIDDLE || !seen.armed {
                return;
            }
            let (axis, model) = (record.axis, record.model);
            let position = model.mechanical_position();
            match seen.stood.iter().find(|(of, _)| *of == axis) {
                None => seen.stood.push((axis, position)),
                Some((_, stood)) if *stood != position => {
                    let text = format!("axis {axis} moved from {stood} to {position}");
                    seen.wrong.push(text);
                }
                Some(_) => {}
            }
            if record.al_state != AlState::Op {
                return;
            }
            let word = model.controlword();
            // Enable operation needs bits 0 to 3; bit 4 starts.
            let starts = word & 0x0F == 0x0F || word & 0x10 != 0;
            let enabled = model.state() == State::OperationEnabled;
            if (starts || enabled) && seen.wrong.len() < 10 {
                let text = format!("axis {axis}: {word:04X}h in {:?}", model.state());
                seen.wrong.push(text);
            }
        });
        this
    }

    fn arm(&self) {
        *self.0.lock().unwrap() = Seen {
            armed: true,
            ..Seen::default()
        };
    }

    fn disarm(&self) {
        self.0.lock().unwrap().armed = false;
    }

    fn seen(&self) -> Vec<String> {
        self.0.lock().unwrap().wrong.clone()
    }
}
