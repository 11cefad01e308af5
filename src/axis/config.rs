//! What an axis core must know before its first cycle.

use core::time::Duration;

use crate::{
    ds402::{
        FollowingErrorWindow, Mode, QuickStopOption, StopOptions, SupportedModes, VelocityWindows,
    },
    profile_position::{Bounds, Limits, Parameters, PositionRange, Traits},
};

use super::{AxisFields, Brake};

/// The settings of an axis core: where its objects lie, how its drive behaves, what counts as arrived, and how long to wait.
///
/// ```
/// use core::time::Duration;
/// use servocrab::{Referencing, axis::{AxisFields, CoreConfig, Deadlines}, coe::AxisOffset, drives};
///
/// let drive = drives::akd2g();
/// let layout = drive.default_mapping()?.layout();
/// let mut config = CoreConfig::new(AxisFields::from_layout(&layout, AxisOffset::of_axis(1))?);
/// config.traits = drive.traits;
/// config.referencing = Referencing::AbsoluteEncoder;
/// config.deadlines = Deadlines { standstill: Duration::from_secs(30), ..Deadlines::default() };
/// assert_eq!(config.tolerances.position, 10);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct CoreConfig {
    /// Where the axis' objects lie in the drive's process data.
    pub fields: AxisFields,
    /// How the drive's Profile Position mode behaves.
    pub traits: Traits,
    /// The mode that is written from the first cycle on.
    pub mode: Mode,
    /// Supported drive modes 6502h as read from the drive: another mode is refused before it is written. None where that is not
    /// known: then each is tried.
    pub supported_modes: Option<SupportedModes>,
    /// What counts as arrived and as standing.
    pub tolerances: Tolerances,
    /// How long each step may take.
    pub deadlines: Deadlines,
    /// When a silent drive counts as lost.
    pub loss: Loss,
    /// Quick stop option code 605Ah as read from the drive: where a quick stop ends.
    pub quick_stop: QuickStopOption,
    /// Option codes 605Bh to 605Eh as read from the drive. Where bit 8 lets the axis coast, `halt` is refused, and every other stop is a
    /// quick stop at once.
    pub stop_options: StopOptions,
    /// Windows and times of the velocity, 606Dh to 6070h, as read from the drive. They are shown and decide nothing.
    pub velocity_windows: VelocityWindows,
    /// Following error window and time out, 6065h and 6066h, as read from the drive. They are shown and decide nothing.
    pub following_error_window: FollowingErrorWindow,
    /// What moves use for the parameters that they leave out: what the drive held when the axis attached.
    pub defaults: Parameters,
    /// What moves are checked against before they are sent: what the drive held when the axis attached. With a mailbox
    /// client `Limits::read` reads it.
    pub limits: Limits,
    /// One turn of a modulo axis, whose positions begin again at its end: a rotary table, a belt. Positions are compared
    /// around it, absolute targets lie within it, and distances may be longer. None for other axes.
    pub modulo: Option<PositionRange>,
    /// How the axis comes to know where it is.
    pub referencing: Referencing,
    /// What holds the axis without power; none where it is not known to have a brake, or where the program sets it.
    pub brake: Option<Brake>,
    /// Whether the drive showed, when the axis attached, that it has been homed and has kept its position since
    /// ([`Traits::homed`]). With it the axis begins as referenced.
    pub homed: bool,
}

impl CoreConfig {
    /// An axis after CiA 402 with its objects there, mode 1, and the default tolerances and deadlines. What its moves leave
    /// out is not known, nor are the drive's limits.
    #[must_use]
    pub fn new(fields: AxisFields) -> Self {
        Self {
            fields,
            traits: Traits::cia402(),
            mode: Mode::ProfilePosition,
            supported_modes: None,
            tolerances: Tolerances::default(),
            deadlines: Deadlines::default(),
            loss: Loss::default(),
            quick_stop: QuickStopOption(2),
            stop_options: StopOptions::default(),
            velocity_windows: VelocityWindows::default(),
            following_error_window: FollowingErrorWindow::default(),
            defaults: Parameters::default(),
            limits: Limits::trust_drive(),
            modulo: None,
            referencing: Referencing::default(),
            brake: None,
            homed: false,
        }
    }
}

impl CoreConfig {
    /// These limits as this axis has them: absolute targets of a modulo axis lie within its turn.
    pub(super) const fn limits_with(&self, limits: Limits) -> Limits {
        match self.modulo {
            Some(turn) => Limits {
                position_range: Some(turn),
                ..limits
            },
            None => limits,
        }
    }

    /// With its turn among its limits, and the time that its drive needs in its deadlines; and the bounds within which this axis counts as
    /// standing.
    pub(super) fn with_bounds(mut self) -> (Self, Bounds) {
        self.limits = self.limits_with(self.limits);
        // Two of its cycles until it has surely seen a bit, and as many for its answer.
        let answer = self.traits.surely_seen().saturating_mul(2);
        let deadlines = &mut self.deadlines;
        deadlines.acknowledge = deadlines.acknowledge.max(answer);
        deadlines.fault_reset = deadlines.fault_reset.max(answer);
        let tolerances = &self.tolerances;
        let drive_cycle = self.traits.drive_cycle;
        let bounds = Bounds::new(
            tolerances.position,
            tolerances.settle,
            drive_cycle,
            self.modulo,
        );
        (self, bounds)
    }
}

/// What counts as arrived and as standing.
///
/// ```
/// use servocrab::axis::Tolerances;
/// // An encoder of 2²⁰ counts a revolution: half a thousandth of a revolution.
/// let tolerances = Tolerances { position: 524, ..Tolerances::default() };
/// assert_eq!(tolerances.settle.as_millis(), 100);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tolerances {
    /// Position units between target and 6064h at arrival, and within which a standing axis stays. `Tolerances::default()` has 10. A
    /// [`Network`](crate::Network) takes the drive's position window 6067h in its place, but only for an axis that is given no `Tolerances`.
    pub position: u32,
    /// How long 6064h must stay within the window to count as standing, and as not on its way.
    pub settle: Duration,
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            position: 10,
            settle: Duration::from_millis(100),
        }
    }
}

/// How long each step of a command may take.
///
/// ```
/// use core::time::Duration;
/// use servocrab::axis::Deadlines;
/// // A drive whose brake takes its time.
/// let deadlines = Deadlines { enable: Duration::from_secs(8), ..Deadlines::default() };
/// assert_eq!(deadlines.acknowledge, Duration::from_millis(500));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Deadlines {
    /// From `Enable` to Operation enabled, with the stop of an axis that is found moving.
    pub enable: Duration,
    /// From `Disable` of a standing axis to Ready to switch on or below.
    pub disable: Duration,
    /// From bit 4 to bit 12, and for bit 12 to fall before a set-point. At least four of the drive's cycles
    /// ([`Traits::drive_cycle`](crate::profile_position::Traits::drive_cycle)) count, however short this is: the drive needs them.
    pub acknowledge: Duration,
    /// From bit 12 until an acknowledged set-point shows that it has begun: bit 10 falls, or the axis leaves where it stood. Of an axis that
    /// rests for so long the set-point ends as [`Failure::Unknown`](crate::Failure::Unknown): with bit 10 high it has not begun, with bit 10 low
    /// at its target it has not ended. Give more where a brake or an input of the drive holds the axis back for longer.
    pub begin: Duration,
    /// From the beginning of a stop to standstill. A stop by bit 8 goes on to its quick stop after three quarters of it. At its end an axis
    /// that was not seen to stand loses its power, unless it is only halted.
    pub standstill: Duration,
    /// From 6060h to 6061h.
    pub mode: Duration,
    /// One edge of bit 7; three are tried. At least four of the drive's cycles count.
    pub fault_reset: Duration,
}

#[cfg(feature = "std")]
impl Deadlines {
    /// All of them, by their names.
    pub(crate) const fn each(&self) -> impl IntoIterator<Item = (&'static str, Duration)> + use<> {
        // A new one is not forgotten here.
        let Self {
            enable,
            disable,
            acknowledge,
            begin,
            standstill,
            mode,
            fault_reset,
        } = *self;
        [
            ("deadline `enable`", enable),
            ("deadline `disable`", disable),
            ("deadline `acknowledge`", acknowledge),
            ("deadline `begin`", begin),
            ("deadline `standstill`", standstill),
            ("deadline `mode`", mode),
            ("deadline `fault_reset`", fault_reset),
        ]
    }
}

impl Default for Deadlines {
    fn default() -> Self {
        Self {
            enable: Duration::from_secs(5),
            disable: Duration::from_secs(5),
            acknowledge: Duration::from_millis(500),
            begin: Duration::from_secs(2),
            standstill: Duration::from_secs(10),
            mode: Duration::from_secs(1),
            fault_reset: Duration::from_millis(300),
        }
    }
}

/// When a silent drive counts as lost.
///
/// ```
/// use servocrab::axis::Loss;
/// let patient = Loss { stale_cycles: 50, undelivered_cycles: 150 };
/// assert!(patient.stale_cycles > Loss::default().stale_cycles);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Loss {
    /// Consecutive cycles without an answer of the drive.
    pub stale_cycles: u32,
    /// Consecutive cycles in which its outputs are not known to have been delivered. Not fewer than `stale_cycles`, and
    /// better more: then the loss of another drive in the same datagram does not count against this one.
    pub undelivered_cycles: u32,
}

impl Default for Loss {
    fn default() -> Self {
        Self {
            stale_cycles: 10,
            undelivered_cycles: 30,
        }
    }
}

// Whether the positions of an axis mean anything: since a homing, by an absolute encoder, or not at all.

/// How an axis comes to know where it is. Without that, absolute moves are refused as
/// [`Failure::NotReferenced`](crate::Failure::NotReferenced); relative moves, homing and jogging need no reference.
///
/// ```
/// use servocrab::{AxisConfig, DriveConfig, Referencing, drives};
/// let drive = DriveConfig::new(drives::akd2g())
///     .axis(AxisConfig::new("lift").referencing(Referencing::AbsoluteEncoder))
///     .axis("belt"); // this one must be homed before its first absolute move
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum Referencing {
    /// By a homing that was attained. The next homing takes the reference away until it is attained. So does every loss of the drive,
    /// until [`Network::recover`](crate::Network::recover) finds that the drive has kept its power: then the axis is referenced again.
    /// A fault alone takes nothing away; a program that knows better homes again.
    ///
    /// A drive that shows that it is homed ([`Traits::homed`](crate::profile_position::Traits::homed)) is asked whenever the axis
    /// attaches. Then a homing by an earlier program counts, for as long as the drive keeps its power.
    #[default]
    ByHoming,
    /// The drive always knows its position, in the coordinates that the program means.
    AbsoluteEncoder,
    /// The axis is moved to absolute positions without knowing what they mean: 6064h counts from wherever the drive was
    /// switched on. For test benches and for axes that nothing stands in the way of.
    UnreferencedMovesAllowed,
}

// What a drive held, when its axis attached, of how it stops and of when it calls its axis standing.

/// What the drive of an axis held, when the axis attached, of how it stops and of when it calls the axis standing, and how it behaves:
/// [`Axis::drive_settings`](crate::Axis::drive_settings).
///
/// ```
/// # use std::time::Duration;
/// use servocrab::{DriveConfig, Network, drives, link::Wire};
/// # smol::block_on(async {
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::generic());
/// # let link = Wire::new(move |frame: &mut [u8], now: Duration| segment.process(frame, now));
/// let drive = DriveConfig::new(drives::generic()).axis("x");
/// let net = Network::builder().link(link).drive(0, drive).start().await?;
/// let held = net.axis("x")?.drive_settings();
/// // 605Dh: bit 8 stops the axis by the ramp of its set-point.
/// assert_eq!(held.stop_options.halt, Some(1));
/// // 606Fh.
/// assert!(held.velocity_windows.threshold.is_some());
/// # net.shutdown().await?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// # }).unwrap();
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct DriveSettings {
    /// Quick stop option code 605Ah, or 2 where the drive has no such object: where a quick stop ends.
    pub quick_stop: QuickStopOption,
    /// Option codes of the other stops, 605Bh to 605Eh.
    pub stop_options: StopOptions,
    /// Windows and times of the velocity, 606Dh to 6070h.
    pub velocity_windows: VelocityWindows,
    /// Following error window and time out, 6065h and 6066h, which are read where the axis has a
    /// [warning](crate::AxisConfig::following_error_warning) that must be below them.
    pub following_error_window: FollowingErrorWindow,
    /// Supported drive modes 6502h. None where the drive has no such object.
    pub supported_modes: Option<SupportedModes>,
    /// One turn of a modulo axis; none of other axes.
    pub turn: Option<PositionRange>,
    /// How its Profile Position mode behaves, as the axis was configured.
    pub traits: Traits,
    /// The brake that it was configured with.
    pub brake: Option<Brake>,
}

#[cfg(feature = "std")]
impl DriveSettings {
    pub(crate) const fn of(config: &super::CoreConfig) -> Self {
        Self {
            quick_stop: config.quick_stop,
            stop_options: config.stop_options,
            velocity_windows: config.velocity_windows,
            following_error_window: config.following_error_window,
            supported_modes: config.supported_modes,
            turn: config.modulo,
            traits: config.traits,
            brake: config.brake,
        }
    }
}
