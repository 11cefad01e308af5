//! The machines: a simulated drive with two axes, shown with a grant to jog `x`; and a line of four devices with all grants.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use servocrab::{
    Axis, AxisConfig, DriveConfig, Network, Referencing, SetPoint,
    bus::{Expected, IoConfig},
    coe::obj,
    drives,
    link::Wire,
    units::{Mm, Ratio, Scale},
};
use servocrab_attach::{Attach, Attached, Grant, serve};
use servocrab_sim::{Segment, personality};

use super::Result;

/// The velocity with which the page jogs, in mm/s: a tenth of what is granted.
pub(crate) const JOG: f64 = 20.0;
/// Counts of a millimetre.
const COUNTS: f64 = 1000.0;

pub(crate) struct Machine {
    segment: Arc<Mutex<Segment>>,
    /// When each frame went by, and how fast `x` was then, in mm/s.
    ledger: Arc<Mutex<Vec<(Instant, f64)>>>,
    net: Network,
    x: Axis<Mm>,
    _y: Axis<Mm>,
    attached: Attached,
    _directory: tempfile::TempDir,
}

impl Machine {
    /// One drive, of which `x` may be jogged.
    pub(crate) fn start() -> Result<Self> {
        let segment = Segment::new().with(personality::akd2g());
        let jog = Grant::Jog {
            axes: vec!["x".into()],
            max_velocity: 10.0 * JOG,
        };
        Self::of(segment, Vec::new(), vec![jog])
    }

    /// The drive, eight inputs, eight outputs, and a coupler that nobody has declared. Everything is granted.
    pub(crate) fn with_all_grants() -> Result<Self> {
        let segment = Segment::new()
            .with(personality::akd2g())
            .with(personality::digital_inputs())
            .with(personality::digital_outputs())
            .with(personality::coupler());
        let ios = vec![
            (1, IoConfig::new("buttons", Expected::new(0, 0x4449_3038))),
            (2, IoConfig::new("valves", Expected::new(0, 0x444F_3038))),
        ];
        let axes = || vec!["x".to_owned(), "y".to_owned()];
        let jog = Grant::Jog {
            axes: axes(),
            max_velocity: 10.0 * JOG,
        };
        let grants = vec![Grant::Parameters, jog, Grant::Motion { axes: axes() }];
        Self::of(segment, ios, grants)
    }

    fn of(segment: Segment, ios: Vec<(u16, IoConfig)>, grants: Vec<Grant>) -> Result<Self> {
        let segment = Arc::new(Mutex::new(segment));
        let ledger = Arc::<Mutex<Vec<_>>>::default();
        let (wired, noted) = (Arc::clone(&segment), Arc::clone(&ledger));
        let wire = Wire::new(move |frame, now| {
            let mut segment = locked(&wired);
            let answer = segment.process(frame, now);
            if let Some(axis) = segment.axis(0, 0) {
                locked(&noted).push((Instant::now(), axis.velocity() / COUNTS));
            }
            answer
        });
        let axis = |name: &str| -> Result<AxisConfig> {
            let counts = Ratio::new(1000, 1)?;
            Ok(AxisConfig::new(name)
                .unit::<Mm>(Scale::counts_per_unit(counts))
                .referencing(Referencing::AbsoluteEncoder)
                .map_output(obj::TARGET_VELOCITY)
                .map_input(obj::FOLLOWING_ERROR_ACTUAL)
                .map_input(obj::TORQUE_ACTUAL))
        };
        let drive = DriveConfig::new(drives::akd2g())
            .axis(axis("x")?)
            .axis(axis("y")?);
        let builder = Network::builder()
            .link(wire)
            .cycle(Duration::from_millis(2))
            // The browser takes the processors for longer than a watchdog usually allows.
            .watchdog(Duration::from_secs(6))
            .drive(0, drive);
        let builder = ios
            .into_iter()
            .fold(builder, |builder, (position, io)| builder.io(position, io));
        let net = smol::block_on(builder.start())?;
        let directory = tempfile::tempdir()?;
        let attach = Attach::new("panel")
            .directory(directory.path().join("servocrab"))
            .loopback(0);
        let attach = grants.into_iter().fold(attach, Attach::grant);
        let attached = serve(&net, attach)?;
        let (x, y) = (net.axis_in("x")?, net.axis_in("y")?);
        Ok(Self {
            segment,
            ledger,
            net,
            x,
            _y: y,
            attached,
            _directory: directory,
        })
    }

    pub(crate) fn panel(&self) -> &str {
        self.attached.panel().unwrap_or_default()
    }

    pub(crate) fn token(&self) -> &str {
        self.panel()
            .split_once("#token=")
            .map_or("", |(_, token)| token)
    }

    pub(crate) fn port(&self) -> Result<u16> {
        let address = self.panel().strip_prefix("http://127.0.0.1:");
        let (port, _) = address
            .and_then(|address| address.split_once('/'))
            .ok_or("no port")?;
        Ok(port.parse()?)
    }

    pub(crate) fn enable(&self) -> Result<()> {
        smol::block_on(async {
            self.x.reset_fault().await?;
            self.x.enable().await
        })?;
        Ok(())
    }

    pub(crate) fn moves_to(&self, position: f64) -> Result<()> {
        smol::block_on(async {
            let lease = self.x.profile_position().await?;
            let set_point = SetPoint::new()
                .velocity(40.0)
                .acceleration(400.0)
                .deceleration(400.0);
            lease.move_abs(position, set_point).await?.done().await?;
            lease.release().await
        })?;
        Ok(())
    }

    pub(crate) fn fault_of_y(&self) {
        if let Some(y) = locked(&self.segment).axis_mut(0, 1) {
            y.inject_fault(0x8611);
        }
    }

    /// The drive leaves OP, as after a watchdog.
    pub(crate) fn drive_leaves_op(&self) {
        if let Some(drive) = locked(&self.segment).device_mut(0) {
            drive.fall_to_safe_op(0x001B);
        }
    }

    /// The first and the third of the eight inputs are on.
    pub(crate) fn press_buttons(&self) {
        if let Some(buttons) = locked(&self.segment).device_mut(1) {
            buttons.set_inputs(&[0b101]);
        }
    }

    /// How fast `x` is, by the drive.
    pub(crate) fn speed(&self) -> f64 {
        locked(&self.ledger)
            .last()
            .map_or(0.0, |(_, velocity)| velocity.abs())
    }

    /// How long after that moment `x` came to a stand for good, by the drive; `None` if it moves.
    pub(crate) fn stood_since(&self, from: Instant) -> Option<Duration> {
        let ledger = locked(&self.ledger);
        // What the servo does to hold its place is less.
        let last = ledger
            .iter()
            .rposition(|(_, velocity)| velocity.abs() > JOG / 20.0)?;
        let (stood, _) = ledger.get(last + 1)?;
        let is_long = ledger.last()?.0.duration_since(*stood) > Duration::from_secs(1);
        is_long.then(|| stood.saturating_duration_since(from))
    }

    pub(crate) fn end(self) -> Result<()> {
        drop(self.attached);
        Ok(smol::block_on(self.net.shutdown())?)
    }
}

fn locked<T>(shared: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}
