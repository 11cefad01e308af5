//! A drive: its mapping, what is read of its axes before any of them can be enabled, and what it does when the process data stop.

use std::{rc::Rc, time::Duration};

use super::{
    config::{AxisConfig, DriveConfig, Turn},
    held_outputs::{Brakes, HeldOutputs},
};
use crate::{
    Referencing,
    axis::{
        AxisFields, BoxFuture, Brake, CoreConfig, Loss, OutputBrake, ParameterAccess, Tolerances,
    },
    bus::{
        clocks::Clocks,
        error::{AtStep, BringUpStep, DriveFault, StepError},
        log::LogRecord,
        requests::Context,
    },
    coe::{
        AxisOffset, DriveError, DriveId, Number, Object, ObjectAddress, ReadOnly, Readable,
        SdoError, SdoHandle, obj,
    },
    ds402::{AbortConnection, QuickStopOption, SupportedModes},
    pdo_map::{self, Direction, Layout, Mapping, MappingError},
    profile_position::{Limits, LimitsRule, MinVelocity, PositionRange, RelativeBase},
    units::{AxisScale, DriveUnits, Ratio, ScaleMismatch},
};

/// What a drive has beside what every device has.
#[derive(Clone)]
pub(in crate::bus) struct Drive {
    pub(super) config: DriveConfig,
    pub(super) mapping: Mapping,
    pub layout: Layout,
    pub held: HeldOutputs,
    pub axes: Vec<ReadyAxis>,
    /// When an axis counts as lost, where the program does not say.
    pub(super) loss: Loss,
    /// The network's cycle.
    pub(super) cycle: Duration,
    /// The line's clocks, where they are used.
    pub(super) clocks: Option<Rc<Clocks>>,
}

/// An axis with what was read from its drive.
#[derive(Clone)]
pub(in crate::bus) struct ReadyAxis {
    pub name: String,
    pub offset: AxisOffset,
    pub scale: AxisScale,
    pub config: CoreConfig,
    /// In counts: a following error beyond it is reported.
    pub following_error_warning: Option<u32>,
    held: HeldLimits,
    /// Whether the drive shows that it is homed, where it shows that.
    pub shows_homed: Option<bool>,
}

/// What the drive holds in its limit objects, each once it was read.
#[derive(Debug, Clone, Copy, Default)]
struct HeldLimits {
    software: [Option<i32>; 2],
    home_offset: Option<i32>,
    position_range: [Option<i32>; 2],
    max_velocity: Option<u32>,
    min_velocity: Option<u16>,
}

impl HeldLimits {
    fn limits(&self) -> Limits {
        let range = |[min, max]: [Option<i32>; 2]| {
            min.zip(max).map(|(min, max)| PositionRange { min, max })
        };
        Limits {
            software: range(self.software),
            home_offset: self.home_offset.unwrap_or(0),
            position_range: range(self.position_range),
            max_velocity: self.max_velocity,
            min_velocity: self.min_velocity,
        }
    }
}

/// When an object is read. What the process data hold is overwritten by the first outputs that the drive takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reading {
    /// Before OP: what is mapped into the outputs.
    Overwritten,
    /// In SAFEOP: all else. No handle of its axes exists yet, or none can enable them.
    Rest,
}

impl Drive {
    /// Why a drive has no mapping. Where no PDO holds a target position, with what the drive has instead.
    pub async fn not_mapped(
        config: &DriveConfig,
        error: MappingError,
        sdo: Option<&SdoHandle>,
    ) -> DriveFault {
        let MappingError::NotOffered { object, .. } = &error else {
            return error.into();
        };
        let axes = config.axes.iter().zip(&config.description.axes);
        let target = |offset: AxisOffset| obj::TARGET_POSITION.offset(offset).address();
        let mut of_axes = axes.filter(|(_, description)| target(description.offset) == *object);
        let (Some((axis, description)), Some(sdo)) = (of_axes.next(), sdo) else {
            return error.into();
        };
        let modes = sdo
            .read(obj::SUPPORTED_MODES.offset(description.offset))
            .await;
        DriveFault::NoTargetPosition {
            axis: axis.name.clone(),
            object: *object,
            modes: SupportedModes::from_bits_retain(modes.unwrap_or(0)),
        }
    }

    /// In PREOP: brings its mapping into it. Where it has less room than its description says, what is needed most is mapped. If not even
    /// that has room, its first refusal is the reason.
    pub async fn map(&mut self, id: &DriveId, sdo: &SdoHandle) -> Result<(), StepError> {
        let step = BringUpStep::Mapping;
        let mut refused = None;
        loop {
            let error = match pdo_map::configure(&self.mapping, sdo).await {
                Ok(layout) => {
                    self.layout = layout;
                    return Ok(());
                }
                Err(error) => error,
            };
            if !self.config.description.limits.learn_from(&error) {
                return Err(error).at(step);
            }
            let first = refused.take().unwrap_or(error);
            let Ok(mapping) = self.config.mapping() else {
                return Err(first).at(step);
            };
            refused = Some(first);
            self.config.log_what_is_not_mapped(&mapping.layout(), id);
            self.mapping = mapping;
        }
    }

    /// In PREOP: its axes as the program declares them, with what the outputs will overwrite. That is all that cycles need in which no
    /// axis is enabled. After an earlier start the outputs bring again what the drive held then: the axes keep it.
    pub(super) async fn open_axes(&mut self, sdo: &SdoHandle) -> Result<(), StepError> {
        let is_first_start = self.axes.is_empty();
        let mut before = core::mem::take(&mut self.axes).into_iter();
        let mut axes = Vec::new();
        for (axis, description) in self.config.axes.iter().zip(&self.config.description.axes) {
            let offset = description.offset;
            let fields = AxisFields::from_layout(&self.layout, offset).at(BringUpStep::Mapping)?;
            if let Some(mut ready) = before.next() {
                ready.config.fields = fields;
                axes.push(ready);
                continue;
            }
            let mut ready = self.unread(axis, offset, fields);
            self.read_axis(Reading::Overwritten, sdo, axis, &mut ready)
                .await?;
            let on_loss = obj::ABORT_CONNECTION_OPTION.offset(offset);
            if self.layout.output(on_loss).is_ok() {
                // It goes out as the drive holds it next. The way of its quick stop is read later, where that is not mapped.
                let code = read_if_there(sdo, obj::QUICK_STOP_OPTION.offset(offset)).await?;
                let quick_stop = code.map_or(ready.config.quick_stop, QuickStopOption);
                stop_on_loss(sdo, axis, offset, quick_stop).await?;
            }
            axes.push(ready);
        }
        self.axes = axes;
        if is_first_start {
            let offsets = self.axes.iter().map(|axis| axis.offset);
            let lists = &self.config.start_up;
            let brakes = Brakes::of(&self.config);
            self.held = HeldOutputs::read(&self.layout, offsets, lists, &brakes, sdo).await?;
        }
        Ok(())
    }

    /// Its axes before anything was read of them, for the time in which the drive is not there.
    pub fn declare_axes(&mut self) -> Result<(), StepError> {
        for (axis, description) in self.config.axes.iter().zip(&self.config.description.axes) {
            let offset = description.offset;
            let fields = AxisFields::from_layout(&self.layout, offset).at(BringUpStep::Mapping)?;
            self.axes.push(self.unread(axis, offset, fields));
        }
        Ok(())
    }

    fn unread(&self, axis: &AxisConfig, offset: AxisOffset, fields: AxisFields) -> ReadyAxis {
        ReadyAxis {
            name: axis.name.clone(),
            offset,
            scale: axis.scale,
            config: self.declared(axis, fields),
            following_error_warning: axis.following_error_counts(),
            held: HeldLimits::default(),
            shows_homed: None,
        }
    }

    /// In PREOP, before anything that is counted in their units: factors as the scales of its axes say, where the program wants that.
    pub async fn write_scales(&self, sdo: &SdoHandle) -> Result<(), StepError> {
        for (axis, description) in self.config.axes.iter().zip(&self.config.description.axes) {
            if axis.scale_mismatch != ScaleMismatch::Write {
                continue;
            }
            let units = read_units(sdo, axis, description.offset).await?;
            let differences = units.differences(&axis.scale, axis.units_per_revolution);
            let writes = differences.iter().filter_map(|one| units.writes(one));
            for (object, value) in writes.flatten() {
                let written = sdo.write(object.offset(description.offset), value).await;
                written.at(BringUpStep::Parameters)?;
            }
        }
        Ok(())
    }

    /// Compares the declared scales of its axes with what the drive says of its units.
    async fn check_scales(&self, context: &Context, sdo: &SdoHandle) -> Result<(), StepError> {
        for (axis, description) in self.config.axes.iter().zip(&self.config.description.axes) {
            let units = read_units(sdo, axis, description.offset).await?;
            for mut difference in units.differences(&axis.scale, axis.units_per_revolution) {
                difference.object.index = description.offset.apply(difference.object.index);
                let axis_name = axis.name.clone();
                match axis.scale_mismatch {
                    ScaleMismatch::Refuse | ScaleMismatch::Write => {
                        let fault = DriveFault::Scale {
                            axis: axis_name,
                            difference,
                        };
                        return Err(fault).at(BringUpStep::Parameters);
                    }
                    ScaleMismatch::Warn => {
                        let note = LogRecord::ScaleDiffers {
                            axis: axis_name,
                            difference,
                        };
                        context.log.record(context.time.now(), note);
                    }
                }
            }
        }
        Ok(())
    }

    /// Reads what is left of the parameters of its axes, and has each of them stop when the process data stop. Before that none of
    /// them is enabled.
    pub(super) async fn read_axes(
        &mut self,
        context: &Context,
        sdo: &SdoHandle,
    ) -> Result<(), StepError> {
        self.check_scales(context, sdo).await?;
        let mut axes = core::mem::take(&mut self.axes);
        for (axis, ready) in self.config.axes.iter().zip(&mut axes) {
            self.read_axis(Reading::Rest, sdo, axis, ready).await?;
            let quick_stop = ready.config.quick_stop;
            if !stop_on_loss(sdo, axis, ready.offset, quick_stop).await? {
                let axis = axis.name.clone();
                let note = LogRecord::NoAbortConnection { axis };
                context.log.record(context.time.now(), note);
            }
        }
        self.axes = axes;
        Ok(())
    }

    /// Takes what its axes did without a set-point's parameters from an earlier start. What goes with no process data is written to it:
    /// a drive that was without power may have stored something else, and one that kept its power has what the last moves have brought.
    pub(super) async fn keep_defaults_of(
        &mut self,
        before: &Self,
        sdo: &SdoHandle,
    ) -> Result<(), StepError> {
        for (axis, before) in self.axes.iter_mut().zip(&before.axes) {
            let fields = &axis.config.fields;
            let (held, first) = (axis.config.defaults, before.config.defaults);
            let [velocity, acceleration, deceleration, end_velocity] = [
                (fields.velocity, held.velocity, first.velocity),
                (fields.acceleration, held.acceleration, first.acceleration),
                (fields.deceleration, held.deceleration, first.deceleration),
                (fields.end_velocity, held.end_velocity, first.end_velocity),
            ];
            for ((mapped, held, first), object) in [
                (velocity, obj::PROFILE_VELOCITY),
                (acceleration, obj::PROFILE_ACCELERATION),
                (deceleration, obj::PROFILE_DECELERATION),
                (end_velocity, obj::END_VELOCITY),
            ] {
                if mapped.is_none()
                    && held != first
                    && let Some(first) = first
                {
                    let written = sdo.write(object.offset(axis.offset), first).await;
                    written.at(BringUpStep::Parameters)?;
                }
            }
            axis.config.defaults = first;
        }
        Ok(())
    }

    /// It stands in place of another one: what its encoder says, or it shows of an earlier homing, is not about this machine. Until the
    /// next start its axes are referenced by a homing alone.
    pub fn forget_positions(&mut self) {
        for axis in &mut self.axes {
            let config = &mut axis.config;
            config.traits.homed = None;
            config.homed = false;
            axis.shows_homed = None;
            if config.referencing == Referencing::AbsoluteEncoder {
                config.referencing = Referencing::ByHoming;
            }
        }
    }

    /// What the program says of an axis.
    fn declared(&self, axis: &AxisConfig, fields: AxisFields) -> CoreConfig {
        let mut config = CoreConfig::new(fields);
        config.traits = self.config.description.traits;
        if let Some(clock) = &self.config.clock {
            // It acts on its process data once for each SYNC0, however short its own cycle is.
            let sync0 = clock.cycle(self.cycle);
            config.traits.drive_cycle = config.traits.drive_cycle.max(sync0);
        }
        config.mode = axis.mode;
        config.deadlines = axis.deadlines;
        config.referencing = axis.referencing;
        config.loss = axis.loss.unwrap_or(self.loss);
        config.tolerances = axis.tolerances.unwrap_or_default();
        config.brake = axis.brake;
        config
    }

    /// Reads what is due of an axis.
    async fn read_axis(
        &self,
        reading: Reading,
        sdo: &SdoHandle,
        axis: &AxisConfig,
        ready: &mut ReadyAxis,
    ) -> Result<(), StepError> {
        let offset = ready.offset;
        let due = Due {
            reading,
            layout: &self.layout,
            sdo,
            offset,
        };
        let config = &mut ready.config;
        if axis.tolerances.is_none()
            && let Some(window) = due.read_if_there(obj::POSITION_WINDOW).await?
        {
            // FFFFFFFFh switches the window off (CiA DSP 402 v2.0, object 6067h).
            let window = window.filter(|window| *window != u32::MAX);
            config.tolerances.position = window.unwrap_or(Tolerances::default().position);
        }
        if let Some(code) = due.read_if_there(obj::QUICK_STOP_OPTION).await? {
            config.quick_stop = code.map_or(config.quick_stop, QuickStopOption);
            if !config.quick_stop.stops_under_control() && !axis.coasts {
                let axis = axis.name.clone();
                return Err(DriveFault::QuickStopCoasts { axis }).at(BringUpStep::Parameters);
            }
        }
        let stops = &mut config.stop_options;
        due.read_into(&mut stops.shutdown, obj::SHUTDOWN_OPTION)
            .await?;
        due.read_into(&mut stops.disable_operation, obj::DISABLE_OPERATION_OPTION)
            .await?;
        due.read_into(&mut stops.halt, obj::HALT_OPTION).await?;
        due.read_into(&mut stops.fault_reaction, obj::FAULT_REACTION_OPTION)
            .await?;
        let windows = &mut config.velocity_windows;
        due.try_read_into(&mut windows.window, obj::VELOCITY_WINDOW)
            .await?;
        due.try_read_into(&mut windows.window_ms, obj::VELOCITY_WINDOW_TIME)
            .await?;
        due.try_read_into(&mut windows.threshold, obj::VELOCITY_THRESHOLD)
            .await?;
        due.try_read_into(&mut windows.threshold_ms, obj::VELOCITY_THRESHOLD_TIME)
            .await?;
        if let Some(warning) = ready.following_error_warning {
            let lag = &mut config.following_error_window;
            due.try_read_into(&mut lag.window, obj::FOLLOWING_ERROR_WINDOW)
                .await?;
            due.try_read_into(&mut lag.time_out_ms, obj::FOLLOWING_ERROR_TIME_OUT)
                .await?;
            if let Some(window) = lag.window.filter(|window| (1..=warning).contains(window)) {
                let axis = axis.name.clone();
                return Err(DriveFault::LateWarning {
                    axis,
                    warning,
                    window,
                })
                .at(BringUpStep::Parameters);
            }
        }
        if let Some(modes) = due.read_if_it_can_be(obj::SUPPORTED_MODES).await? {
            config.supported_modes = modes.map(SupportedModes::from_bits_retain);
            if let Some(modes) = config.supported_modes
                && !modes.allows(config.mode)
                && config.fields.target_velocity.is_none()
            {
                let axis = axis.name.clone();
                return Err(DriveFault::NoProfilePosition { axis, modes })
                    .at(BringUpStep::Parameters);
            }
        }
        // What is kept of an earlier start is what the drive said then.
        let said = self.config.description.traits.relative_base;
        if said == RelativeBase::PositioningOption
            && let Some(code) = due.read_if_there(obj::POSITIONING_OPTION).await?
        {
            config.traits.relative_base = code.map_or(said, RelativeBase::of_positioning_option);
        }
        if let Some(signal) = config.traits.homed {
            let object = Object::<u32, ReadOnly>::new(
                signal.object.index,
                signal.object.subindex,
                "homed signal",
            );
            if let Some(value) = due.read_if_it_can_be(object).await? {
                ready.shows_homed = value.map(|value| signal.is_homed(value));
                config.homed = ready.shows_homed == Some(true);
            }
        }
        let defaults = &mut config.defaults;
        due.read_into(&mut defaults.velocity, obj::PROFILE_VELOCITY)
            .await?;
        due.read_into(&mut defaults.acceleration, obj::PROFILE_ACCELERATION)
            .await?;
        due.read_into(&mut defaults.deceleration, obj::PROFILE_DECELERATION)
            .await?;
        // Whether it is mapped or not: the axis goes on at it where a move has ended.
        due.read_into(&mut defaults.end_velocity, obj::END_VELOCITY)
            .await?;
        if config.fields.profile_type.is_some() {
            due.read_into(&mut defaults.profile_type, obj::MOTION_PROFILE_TYPE)
                .await?;
        }
        if let Some(Brake::Output(brake)) = &axis.brake {
            let quick_stop = config.quick_stop;
            check_brake(&due, axis, brake, quick_stop).await?;
        }
        self.read_limits(&due, axis, ready).await
    }

    /// The limits that moves are checked against, and the turn of a modulo axis: each object when it is due.
    async fn read_limits(
        &self,
        due: &Due<'_>,
        axis: &AxisConfig,
        ready: &mut ReadyAxis,
    ) -> Result<(), StepError> {
        let are_declared = matches!(
            (axis.limits, axis.modulo),
            (Some(_), None | Some(Turn::These(_)))
        );
        if !are_declared {
            let rule = &ready.config.traits.limits;
            due.read_limits(rule, &mut ready.held).await?;
        }
        match due.reading {
            Reading::Overwritten => Ok(()),
            Reading::Rest => ready.settle_limits(axis),
        }
    }
}

/// A brake on an output can be closed before the power goes, and the drive lets the host set that output.
async fn check_brake(
    due: &Due<'_>,
    axis: &AxisConfig,
    brake: &OutputBrake,
    quick_stop: QuickStopOption,
) -> Result<(), StepError> {
    let bit = brake.bit();
    let mask = due.read_if_it_can_be(obj::DIGITAL_OUTPUTS_MASK).await?;
    if let Some(mask) = mask.flatten().filter(|mask| mask & bit == 0) {
        let axis = axis.name.clone();
        return Err(DriveFault::BrakeMasked { axis, mask, bit }).at(BringUpStep::Parameters);
    }
    if due.reading == Reading::Rest && !quick_stop.stays_in_quick_stop_active() {
        let (axis, option) = (axis.name.clone(), quick_stop.0);
        return Err(DriveFault::BrakeNeedsPower { axis, option }).at(BringUpStep::Parameters);
    }
    Ok(())
}

impl ReadyAxis {
    /// Checks moves against what the program declares of the axis, and else against what the drive holds.
    fn settle_limits(&mut self, axis: &AxisConfig) -> Result<(), StepError> {
        let held = self.held.limits();
        self.config.limits = axis.limits.unwrap_or(held);
        let turn = match axis.modulo {
            None => return Ok(()),
            Some(Turn::OfDrive) => held.position_range,
            Some(Turn::These(turn)) => Some(turn),
        };
        self.config.modulo = turn.filter(|turn| turn.length().is_some());
        if self.config.modulo.is_none() {
            let axis = axis.name.clone();
            return Err(DriveFault::NoTurn { axis }).at(BringUpStep::Parameters);
        }
        Ok(())
    }
}

/// What is read of an axis now.
struct Due<'a> {
    reading: Reading,
    layout: &'a Layout,
    sdo: &'a SdoHandle,
    offset: AxisOffset,
}

impl Due<'_> {
    /// Whether the process data overwrite this object of the axis.
    fn is_output(&self, object: ObjectAddress) -> bool {
        let index = self.offset.apply(object.index);
        let place = self.layout.find(Direction::Outputs, index, object.subindex);
        place.is_some()
    }

    fn is_due<T, A>(&self, object: &Object<T, A>) -> bool {
        self.is_output(object.address()) == (self.reading == Reading::Overwritten)
    }

    /// An object that a drive need not have; `None` where it is not due.
    async fn read_if_there<T: Number, A: Readable>(
        &self,
        object: Object<T, A>,
    ) -> Result<Option<Option<T>>, StepError> {
        if !self.is_due(&object) {
            return Ok(None);
        }
        let value = read_if_there(self.sdo, object.offset(self.offset)).await?;
        Ok(Some(value))
    }

    async fn read_into<T: Number, A: Readable>(
        &self,
        place: &mut Option<T>,
        object: Object<T, A>,
    ) -> Result<(), StepError> {
        if let Some(value) = self.read_if_there(object).await? {
            *place = value;
        }
        Ok(())
    }

    async fn read_limits(&self, rule: &LimitsRule, held: &mut HeldLimits) -> Result<(), StepError> {
        if rule.min_velocity != MinVelocity::Absent {
            let object = obj::MIN_PROFILE_VELOCITY;
            self.read_into(&mut held.min_velocity, object).await?;
        }
        let software = [obj::SOFTWARE_LIMIT_MIN, obj::SOFTWARE_LIMIT_MAX];
        self.read_range(&mut held.software, software).await?;
        let range = [obj::POSITION_RANGE_MIN, obj::POSITION_RANGE_MAX];
        self.read_range(&mut held.position_range, range).await?;
        self.read_into(&mut held.home_offset, obj::HOME_OFFSET)
            .await?;
        let object = obj::MAX_PROFILE_VELOCITY;
        self.read_into(&mut held.max_velocity, object).await
    }

    /// Least and greatest of one object.
    async fn read_range<A: Readable>(
        &self,
        place: &mut [Option<i32>; 2],
        range: [Object<i32, A>; 2],
    ) -> Result<(), StepError> {
        if range.iter().all(|object| self.is_due(object)) {
            let index = self.offset.apply(range[0].address().index);
            let list = self.sdo.read_whole_list(index).await;
            if let Some([min, max]) = list.at(BringUpStep::Parameters)?.as_deref() {
                *place = [Some(*min), Some(*max)];
                return Ok(());
            }
        }
        for (object, place) in range.into_iter().zip(place) {
            self.read_into(place, object).await?;
        }
        Ok(())
    }

    /// An object without which the axis attaches all the same, whatever the drive says of it; `None` where it is not due.
    async fn read_if_it_can_be<T: Number, A: Readable>(
        &self,
        object: Object<T, A>,
    ) -> Result<Option<Option<T>>, StepError> {
        if !self.is_due(&object) {
            return Ok(None);
        }
        let value = read_if_it_can_be(self.sdo, object.offset(self.offset)).await?;
        Ok(Some(value))
    }

    async fn try_read_into<T: Number, A: Readable>(
        &self,
        place: &mut Option<T>,
        object: Object<T, A>,
    ) -> Result<(), StepError> {
        if let Some(value) = self.read_if_it_can_be(object).await? {
            *place = value;
        }
        Ok(())
    }
}

/// What the drive says of the units of an axis. Nothing is read of one of which nothing is declared.
async fn read_units(
    sdo: &SdoHandle,
    axis: &AxisConfig,
    offset: AxisOffset,
) -> Result<DriveUnits, StepError> {
    if axis.scale == AxisScale::COUNTS && axis.units_per_revolution.is_none() {
        return Ok(DriveUnits::default());
    }
    let mut held = [None; DriveUnits::FACTORS.len()];
    for (held, [numerator, divisor]) in held.iter_mut().zip(DriveUnits::FACTORS) {
        if let Some(numerator) = read_if_it_can_be(sdo, numerator.offset(offset)).await?
            && let Some(divisor) = read_if_it_can_be(sdo, divisor.offset(offset)).await?
        {
            // A drive that does not use a factor may hold 0.
            *held = Ratio::new(numerator.into(), divisor.into()).ok();
        }
    }
    Ok(DriveUnits {
        factors: DriveUnits::factors(held),
        si_position: read_if_it_can_be(sdo, obj::SI_UNIT_POSITION.offset(offset)).await?,
        si_velocity: read_if_it_can_be(sdo, obj::SI_UNIT_VELOCITY.offset(offset)).await?,
    })
}

/// Sets what the axis does when the process data stop to a value that stops it, and checks what the drive holds then. Whether the
/// drive has that object.
async fn stop_on_loss(
    sdo: &SdoHandle,
    axis: &AxisConfig,
    offset: AxisOffset,
    quick_stop: QuickStopOption,
) -> Result<bool, StepError> {
    let step = BringUpStep::AbortConnection;
    let object = obj::ABORT_CONNECTION_OPTION.offset(offset);
    let Some(mut value) = read_if_there(sdo, object)
        .await
        .map_err(|StepError(_, error)| StepError(step, error))?
    else {
        return Ok(false);
    };
    // A quick stop that only switches off would let the axis coast: then a fault, which has a reaction of its own.
    let preferred = [
        AbortConnection::QuickStop,
        AbortConnection::Malfunction,
        AbortConnection::DisableVoltage,
    ];
    let skip = usize::from(!quick_stop.stops_under_control());
    for choice in preferred.into_iter().skip(skip) {
        if value == choice.raw() {
            return Ok(true);
        }
        match sdo.write(object, choice.raw()).await {
            Ok(()) => {}
            Err(error) if error.error.abort_code().is_some() => continue,
            Err(error) => return Err(error).at(step),
        }
        value = sdo.read(object).await.at(step)?;
        if value == choice.raw() {
            return Ok(true);
        }
    }
    if AbortConnection::from_raw(value).stops() {
        return Ok(true);
    }
    let axis = axis.name.clone();
    Err(DriveFault::DoesNotStop { axis, value }).at(step)
}

/// Reads an object that a drive need not have.
async fn read_if_there<T: Number, A: Readable>(
    sdo: &SdoHandle,
    object: Object<T, A>,
) -> Result<Option<T>, StepError> {
    match sdo.read(object).await {
        Ok(value) => Ok(Some(value)),
        Err(DriveError {
            error: SdoError::Aborted { code, .. },
            ..
        }) if code.is_no_object() => Ok(None),
        Err(error) => Err(error).at(BringUpStep::Parameters),
    }
}

/// Reads an object without which the axis attaches all the same, whatever the drive says of it.
async fn read_if_it_can_be<T: Number, A: Readable>(
    sdo: &SdoHandle,
    object: Object<T, A>,
) -> Result<Option<T>, StepError> {
    match sdo.read(object).await {
        Ok(value) => Ok(Some(value)),
        Err(DriveError {
            error: SdoError::Aborted { .. } | SdoError::WrongSize { .. },
            ..
        }) => Ok(None),
        Err(error) => Err(error).at(BringUpStep::Parameters),
    }
}

/// SDO access for the handles of an axis.
pub(in crate::bus) struct Parameters(pub(in crate::bus) SdoHandle);

impl ParameterAccess for Parameters {
    fn write(&self, object: ObjectAddress, value: Vec<u8>) -> BoxFuture<'_, Result<(), SdoError>> {
        Box::pin(async move {
            self.0
                .write_bytes(object.index, object.subindex, value)
                .await
                .map_err(|error| error.error)
        })
    }

    fn read(&self, object: ObjectAddress) -> BoxFuture<'_, Result<Vec<u8>, SdoError>> {
        Box::pin(async move {
            self.0
                .read_bytes(object.index, object.subindex)
                .await
                .map_err(|error| error.error)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{coe::test_device::rig, drives};

    fn drive_of(config: DriveConfig) -> Drive {
        let mapping = config.mapping().unwrap();
        Drive {
            layout: mapping.layout(),
            config,
            mapping,
            held: HeldOutputs::default(),
            axes: Vec::new(),
            loss: Loss::default(),
            cycle: Duration::from_millis(1),
            clocks: None,
        }
    }

    /// 2010h of another maker is 32 bits wide, and no velocity.
    #[test]
    fn what_the_description_does_not_name_as_a_velocity_is_not_read_of_2010h() {
        let (rig, device, sdo, _) = rig();
        let objects = [0x6081, 0x6083, 0x6084, 0x2010].map(|index| ((index, 0), vec![7, 0, 0, 0]));
        device.0.borrow_mut().objects.extend(objects);
        let read = rig.run(async move {
            let mut read = Vec::new();
            for what in [MinVelocity::Absent, MinVelocity::UnitUnknown] {
                let mut description = drives::generic();
                description.traits.limits.min_velocity = what;
                let mut drive = drive_of(DriveConfig::new(description).axis("z"));
                drive.open_axes(&sdo).await.unwrap();
                let mut ready = drive.axes.remove(0);
                let axis = drive.config.axes[0].clone();
                let rest = drive.read_axis(Reading::Rest, &sdo, &axis, &mut ready);
                let is_read = rest.await.is_ok();
                read.push(is_read.then_some(ready.config.limits.min_velocity));
            }
            read
        });
        assert_eq!(read, [Some(None), None], "named, it has another width");
    }

    /// What is kept of an earlier start is overwritten by what the drive says now, also where it says that it has nothing any more.
    #[test]
    fn nothing_is_left_of_what_the_drive_said_at_an_earlier_start() {
        let (rig, device, sdo, _) = rig();
        let mut drive = drive_of(DriveConfig::new(drives::generic()).axis("z"));
        let says = move |window: u32, option: u16| {
            let mut state = device.0.borrow_mut();
            let objects = &mut state.objects;
            objects.insert((0x6067, 0), window.to_le_bytes().to_vec());
            objects.insert((0x60F2, 0), option.to_le_bytes().to_vec());
            for parameter in [0x6081, 0x6083, 0x6084] {
                objects.insert((parameter, 0), vec![0; 4]);
            }
        };
        let known = rig.run(async move {
            let mut known = Vec::new();
            for (window, option) in [(50_000, 0), (u32::MAX, 2), (70, 1)] {
                says(window, option);
                drive.open_axes(&sdo).await.unwrap();
                let mut ready = drive.axes.remove(0);
                let axis = drive.config.axes[0].clone();
                let read = drive.read_axis(Reading::Rest, &sdo, &axis, &mut ready);
                read.await.unwrap();
                known.push((
                    ready.config.tolerances.position,
                    ready.config.traits.relative_base,
                ));
                drive.axes.push(ready);
            }
            known
        });
        let expected = [
            (50_000, RelativeBase::PreviousTarget),
            (Tolerances::default().position, RelativeBase::Actual),
            (70, RelativeBase::Demand),
        ];
        assert_eq!(known, expected);
    }
}
