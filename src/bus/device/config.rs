//! What a program says of the drives in its line.

use std::time::Duration;

use crate::{
    Referencing,
    axis::{Brake, Deadlines, Loss, OutputBrake, Tolerances},
    bus::{clocks::DistributedClock, expected::Expected},
    coe::{AnyObject, DriveId, ErrorTexts, obj},
    drives::{DriveDescription, FurtherObject},
    ds402::{DigitalInput, Mode},
    parameters::{StartUpLines, StartUpList},
    pdo_map::{Direction, Layout, Mapping, MappingError},
    profile_position::{Limits, PositionRange},
    units::{AxisScale, Ratio, Scale, ScaleMismatch, Unit},
};

/// A drive of the line: what it is, its axes, and what is to be configured.
///
/// ```
/// use servocrab::{AxisConfig, DriveConfig, coe::obj, drives};
/// let drive = DriveConfig::new(drives::akd2g())
///     .axis(AxisConfig::new("x").map_input(obj::DIGITAL_INPUTS))
///     .axis("y");
/// ```
#[derive(Debug, Clone)]
pub struct DriveConfig {
    pub(in crate::bus) description: DriveDescription,
    pub(in crate::bus) axes: Vec<AxisConfig>,
    pub(in crate::bus) start_up: Vec<StartUpList>,
    /// Beside what the description says.
    expected: Expected,
    pub(in crate::bus) clock: Option<DistributedClock>,
    mistakes: Vec<String>,
}

/// An axis of a drive as the program wants it. A name alone is one that leaves all as it is: `DriveConfig::axis("x")`.
///
/// ```
/// use servocrab::{AxisConfig, DriveConfig, Referencing, drives, units::{Mm, Ratio, Scale}};
/// let lift = AxisConfig::new("lift")
///     .referencing(Referencing::AbsoluteEncoder)
///     .unit::<Mm>(Scale::counts_per_unit(Ratio::new(1000, 1)?));
/// let drive = DriveConfig::new(drives::akd2g()).axis(lift).axis("belt");
/// # Ok::<(), servocrab::units::ScaleError>(())
/// ```
#[derive(Debug, Clone)]
pub struct AxisConfig {
    pub(in crate::bus) name: String,
    pub(in crate::bus) tolerances: Option<Tolerances>,
    pub(in crate::bus) deadlines: Deadlines,
    pub(in crate::bus) loss: Option<Loss>,
    pub(in crate::bus) mode: Mode,
    pub(in crate::bus) scale: AxisScale,
    pub(in crate::bus) units_per_revolution: Option<Ratio>,
    pub(in crate::bus) scale_mismatch: ScaleMismatch,
    pub(in crate::bus) referencing: Referencing,
    pub(in crate::bus) limits: Option<Limits>,
    pub(in crate::bus) modulo: Option<Turn>,
    /// Whether its quick stop may let it coast.
    pub(in crate::bus) coasts: bool,
    pub(in crate::bus) brake: Option<Brake>,
    is_vertical: bool,
    /// In its unit.
    following_error_warning: Option<f64>,
    outputs: Vec<FurtherObject>,
    inputs: Vec<FurtherObject>,
}

/// Which positions are one turn of a modulo axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) enum Turn {
    /// What the drive holds in 607Bh.
    OfDrive,
    These(PositionRange),
}

impl DriveConfig {
    /// A drive of this kind. Its axes are declared by [`axis`](Self::axis), in order; those that are not are not used.
    #[must_use]
    pub const fn new(description: DriveDescription) -> Self {
        Self {
            description,
            axes: Vec::new(),
            start_up: Vec::new(),
            expected: Expected::any(),
            clock: None,
            mistakes: Vec::new(),
        }
    }

    /// A drive as its maker's ESI file describes it: its axes, PDOs and limits, and its `InitCmd`s as a start-up list (feature `esi`).
    ///
    /// ```
    /// use servocrab::{DriveConfig, Network, esi::Esi};
    /// # let file = concat!(env!("CARGO_MANIFEST_DIR"), "/sim/esi/generic.xml");
    /// let esi = Esi::load(file)?;
    /// // Product code and revision, as a scan shows them.
    /// let device = esi.device(0x4453_0402, 1)?;
    /// let drive = DriveConfig::from_esi(device)?.axis("x");
    /// let network = Network::builder().drive(0, drive);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`EsiDriveError`](crate::esi::EsiDriveError): the device has no axis, or an `InitCmd` that cannot be executed.
    #[cfg(feature = "esi")]
    pub fn from_esi(device: &crate::esi::EsiDevice) -> Result<Self, crate::esi::EsiDriveError> {
        Ok(Self::new(device.description()?).start_up(device.start_up_list()?))
    }

    /// What error codes of the drive mean by its maker's manual, beside what the description has. The texts stand in the errors of its
    /// axes, in its emergencies and in its history.
    ///
    /// ```
    /// # #[cfg(feature = "files")]
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// use servocrab::{DriveConfig, coe::ErrorTexts, drives};
    /// let texts = ErrorTexts::from_toml("FF01h = \"brake resistor missing\"", "alarms.toml")?;
    /// let drive = DriveConfig::new(drives::generic()).error_texts(texts).axis("x");
    /// # Ok(())
    /// # }
    /// # #[cfg(not(feature = "files"))]
    /// # fn main() {}
    /// ```
    #[must_use]
    pub fn error_texts(mut self, texts: ErrorTexts) -> Self {
        self.description.error_texts.extend(texts);
        self
    }

    /// Only a drive of this revision is the one.
    #[must_use]
    pub const fn revision(mut self, revision: u32) -> Self {
        self.expected.revision = Some(revision);
        self
    }

    /// Only the drive with this serial number is the one: so that two of a kind cannot be exchanged unnoticed.
    #[must_use]
    pub const fn serial(mut self, serial: u32) -> Self {
        self.expected.serial = Some(serial);
        self
    }

    /// Declares the drive's next axis, by its name or by what the program wants of it.
    #[must_use]
    pub fn axis(mut self, axis: impl Into<AxisConfig>) -> Self {
        self.axes.push(axis.into());
        self
    }

    /// Changes an axis that was declared before, by its name. A program that declares the axis itself needs no such call: it gives
    /// [`axis`](Self::axis) all at once. This is for a declaration that comes from elsewhere, such as one function for all machines of a kind,
    /// of which a single machine differs in an axis. A name that no axis has is a mistake, which `start()` reports.
    ///
    /// ```
    /// use servocrab::{DriveConfig, Referencing, drives};
    /// let line = DriveConfig::new(drives::akd2g()).axis("x").axis("y");
    /// let with_encoder = line.change_axis("y", |y| y.referencing(Referencing::AbsoluteEncoder));
    /// ```
    #[must_use]
    pub fn change_axis(
        mut self,
        name: &str,
        change: impl FnOnce(AxisConfig) -> AxisConfig,
    ) -> Self {
        match self.axes.iter_mut().find(|axis| axis.name == name) {
            Some(axis) => *axis = change(axis.clone()),
            None => self
                .mistakes
                .push(format!("`{name}` is no axis of this drive: name it first")),
        }
        self
    }

    /// Writes this start-up list, or a single line of one, at its transitions: those of PREOP before the PDO mapping. Several
    /// lists are written in the order of the calls, but scaling first, as [`StartUpList`] says, across all of them. A scaling line at
    /// SAFEOP-OP is a mistake, which `start()` reports.
    #[must_use]
    pub fn start_up(mut self, list: impl Into<StartUpList>) -> Self {
        self.start_up.push(list.into());
        self
    }

    /// Synchronises the drive by its distributed clock. Without it the clock stays off.
    #[must_use]
    pub const fn dc(mut self, clock: DistributedClock) -> Self {
        self.clock = Some(clock);
        self
    }

    /// What the line is to have at its place.
    pub(in crate::bus) fn expected(&self) -> Expected {
        Expected {
            name: self.description.name.clone(),
            vendor: self.description.vendor,
            product: self.description.product,
            ..self.expected.clone()
        }
    }

    /// What is wrong with the declaration itself.
    pub(in crate::bus) fn mistake(&self) -> Option<String> {
        if let Some(mistake) = self.mistakes.first() {
            return Some(mistake.clone());
        }
        let lines = StartUpLines::all(&self.start_up);
        if let Some(mistake) = lines.mistake().or_else(|| lines.late_scaling()) {
            return Some(format!("start-up list: {mistake}"));
        }
        if let Some(mistake) = self.axes.iter().find_map(AxisConfig::mistake) {
            return Some(mistake);
        }
        let (named, there) = (self.axes.len(), self.description.axes.len());
        if named == 0 {
            return Some(format!(
                "no axis of the {} was named",
                self.description.name
            ));
        }
        (named > there).then(|| {
            format!(
                "{named} axes were named, but the {} has {there}",
                self.description.name
            )
        })
    }

    /// Writes to the log which objects of the description and of the program no PDO of the drive has room for.
    pub(in crate::bus) fn log_what_is_not_mapped(&self, layout: &Layout, drive: &DriveId) {
        for (axis, description) in self.axes.iter().zip(&self.description.axes) {
            for (direction, objects, further) in [
                (Direction::Outputs, &description.outputs, &axis.outputs),
                (Direction::Inputs, &description.inputs, &axis.inputs),
            ] {
                let further = further.iter().map(|further| &further.object);
                for object in objects.iter().chain(further) {
                    let own = object.offset(description.offset);
                    if layout.find(direction, own.index, own.subindex).is_none() {
                        tracing::info!(
                            target: crate::log_target::DRIVE,
                            axis = axis.name,
                            %drive,
                            object = %own.address(),
                            "{} is in no PDO that can be assigned: it goes by SDO or not at all",
                            own.name
                        );
                    }
                }
            }
        }
    }

    /// The mapping of the named axes, with what was mapped beside the description's own objects.
    pub(in crate::bus) fn mapping(&self) -> Result<Mapping, MappingError> {
        let further = self.axes.iter();
        self.description
            .mapping_with(further.map(|axis| (axis.outputs.as_slice(), axis.inputs.as_slice())))
    }
}

impl AxisConfig {
    /// An axis with this name. What is said of it beside that is read from the drive, or has its default.
    #[must_use]
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            tolerances: None,
            deadlines: Deadlines::default(),
            loss: None,
            mode: Mode::ProfilePosition,
            scale: AxisScale::COUNTS,
            units_per_revolution: None,
            scale_mismatch: ScaleMismatch::default(),
            referencing: Referencing::default(),
            limits: None,
            modulo: None,
            coasts: false,
            brake: None,
            is_vertical: false,
            following_error_warning: None,
            outputs: Vec::new(),
            inputs: Vec::new(),
        }
    }

    /// What is wrong with the declaration itself.
    fn mistake(&self) -> Option<String> {
        if let Some(warning) = self.following_error_warning
            && self.following_error_counts().is_none()
        {
            return Some(format!(
                "`following_error_warning` of axis `{}` is {warning} {}: it must be at least one count, and at most what 60F4h can show",
                self.name,
                self.scale.unit()
            ));
        }
        let limits = self
            .limits
            .map(|limits| [limits.software, limits.position_range]);
        let mut ranges = limits.into_iter().flatten().flatten();
        // A drive takes such limits for none at all.
        if let Some(range) = ranges.find(|range| range.min >= range.max) {
            return Some(format!(
                "`limits` gives axis `{}` the positions {} to {}, which bound nothing: the least must be below the greatest; where \
                 nothing is to be checked, say `None`",
                self.name, range.min, range.max
            ));
        }
        if let Some(Brake::Output(brake)) = &self.brake {
            if let Some(mistake) = brake_mistake(brake, &self.deadlines) {
                return Some(format!("`brake` of axis `{}`: {mistake}", self.name));
            }
            if self.is_vertical && !brake.is_set_by_drive {
                return Some(format!(
                    "axis `{}` is vertical, and its brake is on an output: the host closes it too late in a fault, a loss or at its own end. Let \
                     the drive manage the brake, or have it close this output in a fault and when its process data stop, and say so \
                     (`OutputBrake::set_by_drive`)",
                    self.name
                ));
            }
        }
        match self.modulo {
            Some(Turn::These(turn)) if turn.length().is_none() => Some(format!(
                "`modulo_over` gives axis `{}` the positions {} to {}, which are no turn: its greatest position must be above \
                 its least, and not both the ends of the type",
                self.name, turn.min, turn.max
            )),
            _ => None,
        }
    }

    /// How it comes to know where it is. Without it: by homing, and absolute moves are refused before.
    #[must_use]
    pub const fn referencing(mut self, referencing: Referencing) -> Self {
        self.referencing = referencing;
        self
    }

    /// It counts in this unit: [`Network::axis_in`](crate::Network::axis_in) gives its handle. Without it it counts in the drive's
    /// own units. At every start and recovery the scale is compared with what the drive says of its velocities and accelerations (6096h,
    /// 6097h) and, if the unit is a length, of its SI units (60A8h, 60A9h): see [`scale_mismatch`](Self::scale_mismatch).
    #[must_use]
    pub fn unit<U: Unit>(mut self, scale: Scale) -> Self {
        self.scale = AxisScale::of::<U>(scale);
        self
    }

    /// One revolution of the drive's shaft, behind the gear 6091h, moves the axis by this number of its units: 5 for a spindle of 5 mm.
    /// Only the program knows that. With it, the scale is also compared with the feed constant 6092h (of older drives with 6093h).
    #[must_use]
    pub const fn units_per_revolution(mut self, units: Ratio) -> Self {
        self.units_per_revolution = Some(units);
        self
    }

    /// What is done where the declared scale contradicts the drive; [`ScaleMismatch::Refuse`] if not said. An object that the drive
    /// does not have, or in which it holds 0, contradicts nothing.
    ///
    /// ```
    /// use servocrab::{AxisConfig, units::{Mm, Ratio, Scale, ScaleMismatch}};
    /// // The drive is to count micrometres of a spindle of 5 mm: 6092h is written as 5000 where it holds something else.
    /// let slide = AxisConfig::new("x")
    ///     .unit::<Mm>(Scale::counts_per_unit(Ratio::new(1000, 1)?))
    ///     .units_per_revolution(Ratio::new(5, 1)?)
    ///     .scale_mismatch(ScaleMismatch::Write);
    /// # Ok::<(), servocrab::units::ScaleError>(())
    /// ```
    #[must_use]
    pub const fn scale_mismatch(mut self, mismatch: ScaleMismatch) -> Self {
        self.scale_mismatch = mismatch;
        self
    }

    /// Maps one more object of it into what the master writes. The object is that of a first axis. A drive that cannot exchange it is
    /// refused at bring-up. Until the program sets it ([`Axis::output`](crate::Axis::output)), it goes out as the drive held it at the
    /// start, or as a line of the [start-up list](DriveConfig::start_up) in PREOP says. An object that cannot be read needs such a line. 6007h
    /// goes out as a value that stops the axis. A command goes out as 0 if no line says otherwise: an offset of a set-point, a touch probe.
    ///
    /// Bit 0 of 60FEh:1, "set brake", goes out as 1 until the program clears it, whatever the drive held.
    ///
    /// ```
    /// use servocrab::{AxisConfig, DriveConfig, coe::obj, drives, parameters::StartUpWrite};
    /// // The brake is set, output 16 is on, and the mask lets the drive obey both.
    /// let lift = DriveConfig::new(drives::generic())
    ///     .axis(AxisConfig::new("lift").map_output(obj::DIGITAL_OUTPUTS))
    ///     .start_up(StartUpWrite::new(obj::DIGITAL_OUTPUTS, 0x0001_0001))
    ///     .start_up(StartUpWrite::new(obj::DIGITAL_OUTPUTS_MASK, 0x0001_0001));
    /// ```
    #[must_use]
    pub fn map_output(mut self, object: impl Into<AnyObject>) -> Self {
        self.outputs.push(FurtherObject::required(object));
        self
    }

    /// Maps one more object of it into what the master reads. The object is that of a first axis. A drive that cannot exchange it is
    /// refused at bring-up.
    #[must_use]
    pub fn map_input(mut self, object: impl Into<AnyObject>) -> Self {
        self.inputs.push(FurtherObject::required(object));
        self
    }

    /// As [`map_output`](Self::map_output), for a drive that may have no room for the object. It is left out where all PDOs are of a fixed
    /// content and none that can be assigned holds it. The log says so. PDOs with a free content take it in any case, so there the drive
    /// must have it.
    ///
    /// ```
    /// use servocrab::{AxisConfig, DriveConfig, coe::obj, drives};
    /// let axis = AxisConfig::new("x").map_input_if_there(obj::DIGITAL_INPUTS);
    /// let drive = DriveConfig::new(drives::generic()).axis(axis);
    /// ```
    #[must_use]
    pub fn map_output_if_there(mut self, object: impl Into<AnyObject>) -> Self {
        self.outputs.push(FurtherObject::if_there(object));
        self
    }

    /// As [`map_input`](Self::map_input), for a drive that may have no room for the object. It is left out where
    /// [`map_output_if_there`](Self::map_output_if_there) leaves an output out.
    #[must_use]
    pub fn map_input_if_there(mut self, object: impl Into<AnyObject>) -> Self {
        self.inputs.push(FurtherObject::if_there(object));
        self
    }

    /// What counts as arrived and as standing, with a settle time of at most 60 s. It replaces all of them: the drive's 6067h and 606Fh are
    /// not used then, nor for fields left at `Tolerances::default()` (10 position units, velocity 0, 100 ms). Without it the position window
    /// 6067h is read from the drive, and its threshold 606Fh where that is in the unit of 606Ch.
    #[must_use]
    pub const fn tolerances(mut self, tolerances: Tolerances) -> Self {
        self.tolerances = Some(tolerances);
        self
    }

    /// How long each step of a command may take: each 1 ms to 1 h.
    #[must_use]
    pub const fn deadlines(mut self, deadlines: Deadlines) -> Self {
        self.deadlines = deadlines;
        self
    }

    /// When it counts as lost: after at least one stale cycle, not fewer undelivered ones, and at most 60 s. Without it: after half of the
    /// watchdog's time, but not less than ten cycles.
    #[must_use]
    pub const fn loss(mut self, loss: Loss) -> Self {
        self.loss = Some(loss);
        self
    }

    /// What its moves are checked against, in place of what the drive holds. Without it its limit objects are read when it attaches; with
    /// [`Limits::trust_drive`] nothing is checked. A range whose minimum is not below its maximum is a mistake, which `start()` reports.
    #[must_use]
    pub const fn limits(mut self, limits: Limits) -> Self {
        self.limits = Some(limits);
        self
    }

    /// Accepts a drive whose quick stop option code 605Ah is 0: at quick stop it switches off, and the axis coasts. Without this such a
    /// drive is refused. A `stop()` of this axis halts it first, by bit 8.
    #[must_use]
    pub const fn coast_at_quick_stop(mut self) -> Self {
        self.coasts = true;
        self
    }

    /// What holds it without power. With a brake on an output of the drive `enable()` ends once that is open, and it is closed before the power
    /// goes. Its output, and its feedback if there is one, are mapped; the mask 60FEh:2 must enable the output
    /// ([`DriveFault::BrakeMasked`](crate::bus::DriveFault::BrakeMasked)), and quick stop must leave the axis powered: 605Ah = 5 to 8
    /// ([`DriveFault::BrakeNeedsPower`](crate::bus::DriveFault::BrakeNeedsPower)).
    ///
    /// ```
    /// use std::time::Duration;
    /// use servocrab::{AxisConfig, DriveConfig, axis::OutputBrake, coe::obj, drives, ds402::DigitalOutput, parameters::StartUpWrite};
    /// let ms = Duration::from_millis;
    /// let brake = OutputBrake::new(DigitalOutput::SetBrake, ms(100), ms(50));
    /// let drive = DriveConfig::new(drives::generic())
    ///     .axis(AxisConfig::new("table").brake(brake))
    ///     .start_up(StartUpWrite::new(obj::DIGITAL_OUTPUTS_MASK, 1))
    ///     .start_up(StartUpWrite::new(obj::QUICK_STOP_OPTION, 6));
    /// ```
    #[must_use]
    pub fn brake(mut self, brake: impl Into<Brake>) -> Self {
        let brake = brake.into();
        if let Brake::Output(output) = &brake {
            self.outputs
                .push(FurtherObject::required(obj::DIGITAL_OUTPUTS));
            if output.feedback.is_some() {
                self.inputs
                    .push(FurtherObject::required(obj::DIGITAL_INPUTS));
            }
        }
        self.brake = Some(brake);
        self
    }

    /// Its load hangs: without power and brake it falls. A brake on an output is refused then, unless
    /// [the drive closes it too](crate::axis::OutputBrake::set_by_drive).
    #[must_use]
    pub const fn vertical(mut self) -> Self {
        self.is_vertical = true;
        self
    }

    /// Reports a following error (60F4h, which is mapped by this) beyond this level in its unit, as
    /// [`NetworkEvent::FollowingErrorHigh`](crate::bus::NetworkEvent::FollowingErrorHigh): once, until it was below half of it. The drive
    /// itself has a fault beyond 6065h, so a level that is not below that is refused at bring-up.
    ///
    /// ```
    /// use servocrab::{AxisConfig, DriveConfig, drives};
    /// let axis = AxisConfig::new("x").following_error_warning(500.0);
    /// let drive = DriveConfig::new(drives::akd2g()).axis(axis);
    /// ```
    #[must_use]
    pub fn following_error_warning(mut self, level: f64) -> Self {
        if self.following_error_warning.replace(level).is_none() {
            self.inputs
                .push(FurtherObject::required(obj::FOLLOWING_ERROR_ACTUAL));
        }
        self
    }

    /// The level of that in counts; `None` where there is none, or it is none.
    pub(in crate::bus) fn following_error_counts(&self) -> Option<u32> {
        let counts = self.scale.scale().position(self.following_error_warning?);
        u32::try_from(counts.ok()?).ok().filter(|&level| level > 0)
    }

    /// Makes it a modulo axis: its positions begin again at the end of the drive's position range 607Bh, which is read when it attaches.
    #[must_use]
    pub const fn modulo(mut self) -> Self {
        self.modulo = Some(Turn::OfDrive);
        self
    }

    /// Makes it a modulo axis with this turn: for drives that have no 607Bh.
    #[must_use]
    pub const fn modulo_over(mut self, turn: PositionRange) -> Self {
        self.modulo = Some(Turn::These(turn));
        self
    }
}

/// Longer than any brake takes to open.
const LONGEST_RELEASE: Duration = Duration::from_secs(60);

/// What is wrong with the declaration of a brake.
fn brake_mistake(brake: &OutputBrake, deadlines: &Deadlines) -> Option<&'static str> {
    let has_input = |(input, _): (DigitalInput, bool)| input.mask().is_some();
    if brake.output.mask().is_none() || !brake.feedback.is_none_or(has_input) {
        Some("60FDh and 60FEh have the bits 0 to 31")
    } else if brake.set >= deadlines.disable {
        Some("its `set` time must be shorter than the deadline `disable`")
    } else if brake.release >= LONGEST_RELEASE {
        Some("its `release` time must be shorter than a minute")
    } else {
        None
    }
}

impl From<&str> for AxisConfig {
    fn from(name: &str) -> Self {
        Self::new(name)
    }
}

impl From<&String> for AxisConfig {
    fn from(name: &String) -> Self {
        Self::new(name)
    }
}

impl From<String> for AxisConfig {
    fn from(name: String) -> Self {
        Self::new(name)
    }
}

/// What fits into register 0420h, in ticks of 100 µs.
const LONGEST_WATCHDOG: Duration = Duration::from_millis(6500);

/// What happens when the process data stop.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::bus) enum Watchdog {
    /// The drives leave OP after this time; twenty cycles, but not less than 100 ms and not more than the register
    /// takes, if not said.
    Armed(Option<Duration>),
    /// Nothing, for this reason.
    Off(String),
}

impl Watchdog {
    /// The watchdog time for this cycle.
    pub fn time(&self, cycle: Duration) -> Option<Duration> {
        match self {
            Self::Armed(time) => Some(
                time.unwrap_or((cycle * 20).clamp(Duration::from_millis(100), LONGEST_WATCHDOG)),
            ),
            Self::Off(_) => None,
        }
    }

    /// When an axis counts as lost, where the program does not say: early enough before the watchdog stops it, and
    /// not at every hiccup of an operating system that is not made for real time.
    pub fn loss(&self, cycle: Duration) -> Loss {
        let time = self.time(cycle).unwrap_or(Duration::from_millis(100));
        let cycles = (time / 2).as_nanos() / cycle.as_nanos().max(1);
        let least = Loss::default();
        let stale_cycles = u32::try_from(cycles)
            .unwrap_or(u32::MAX)
            .max(least.stale_cycles);
        Loss {
            stale_cycles,
            undelivered_cycles: stale_cycles.saturating_mul(3),
        }
    }
}
