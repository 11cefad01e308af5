//! All axes of a network in the cycle: commands in, stops last, groups together, cores stepped, reports out.

use std::{cell::RefCell, rc::Rc, sync::Arc, time::Duration};

use crate::{
    Failure, StopRequest,
    axis::{
        AxisCore, AxisIdentity, AxisPort, AxisSet, AxisSetup, AxisSource, Brake, Command,
        CommandId, GroupQueue, Groups, Inputs, LivenessWatch, Reattach,
    },
    bus::{
        cycle::{
            Answer, Drives, Stepper,
            black_box::{AxisIncident, BlackBox, RecordedAxis, RecordedCycle},
        },
        device::{Device, drive::Parameters, held_outputs::HeldOutputs},
        error::MovingAxis,
        event::NetworkEvent,
        log::Log,
        watch::{Control, TransitionLog},
    },
    coe::obj,
    ds402::{Controlword, State},
    pdo_map::{BitRange, Direction, Field},
    units::AxisScale,
    wakes::{Wakes, stored},
};

/// The command by which the network itself disables an axis: no handle gives this number.
const OWN_COMMAND: CommandId = CommandId(u32::MAX);

/// The axes of a network.
pub(in crate::bus) struct Axes {
    axes: Vec<RunningAxis>,
    /// What the outputs of the drives began with, each with the drive's place in the exchange.
    held: Vec<(usize, HeldOutputs)>,
    /// Digital outputs and makers' objects are that again from now on.
    has_ended: bool,
    groups: Groups,
    /// How many there were.
    cycles: u64,
    /// The program's last rule, and whether it has expired.
    watch: Option<LivenessWatch>,
    expired: bool,
    /// All axes are disabled for good, for this reason.
    disabling: Option<Failure>,
    /// Whether it was not known of the outputs of the last cycle whether they were delivered.
    was_doubted: bool,
    transitions: TransitionLog,
    /// In the order of `axes`.
    recorded: Vec<RecordedAxis>,
    /// Of the axes of which the program wants that.
    lags: Vec<LagWatch>,
    control: Arc<Control>,
}

struct RunningAxis {
    /// The place of its drive in the exchange.
    drive: usize,
    core: AxisCore,
    port: AxisPort,
    /// Its brake, where its outputs hold that and its core does not set it.
    brake: Option<UndeclaredBrake>,
    /// How far it is on its way to be disabled for good.
    leaving: Leaving,
}

/// Watches the following error of an axis.
struct LagWatch {
    axis: Arc<AxisIdentity>,
    scale: AxisScale,
    /// The place of its drive in the exchange, and where 60F4h lies there.
    drive: usize,
    field: Field<i32>,
    /// In counts.
    level: u32,
    is_high: bool,
    /// The one that is still to be reported.
    high: Option<i32>,
}

impl LagWatch {
    fn look(&mut self, drives: &Drives) {
        let inputs = drives.get(self.drive);
        let fresh = inputs.filter(|drive| drive.worth() != Answer::Stale);
        let Some(lag) = fresh.and_then(|drive| self.field.read(&drive.inputs)) else {
            return;
        };
        let size = lag.unsigned_abs();
        if size > self.level && !self.is_high {
            (self.is_high, self.high) = (true, Some(lag));
        } else if size <= self.level / 2 {
            self.is_high = false;
        }
    }

    fn take_event(&mut self) -> Option<NetworkEvent> {
        let scale = self.scale.scale();
        Some(NetworkEvent::FollowingErrorHigh {
            following_error: scale.position_of(self.high.take()?),
            axis: Arc::clone(&self.axis),
            level: scale.position_of(self.level),
            unit: self.scale.unit(),
        })
    }
}

/// A brake that goes with the process data and that the program opens and closes: bit 0 of 60FEh:1.
struct UndeclaredBrake {
    bit: BitRange,
    /// It is set, and no handle opens it any more.
    is_set_for_good: bool,
    /// How long the axis may take to stand before that.
    patience: Duration,
}

/// How long an axis that is disabled for good keeps its power once its brake is set. Assumed: the holding brakes of servo motors close within
/// 10 ms to 200 ms.
const BRAKE_CLOSES_IN: Duration = Duration::from_millis(300);

/// How far an axis is that is to be disabled for good. What hangs is held by the drive until its brake holds it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Leaving {
    /// Not on its way, or silent: a core of which the drive is silent takes nothing, and drops what it was asked for.
    No,
    /// Halted with its brake open, which is set at standstill, or then.
    Halting { until: Duration },
    /// Its brake closes until then.
    Braking { until: Duration },
    /// Its core has taken that it is disabled.
    Disabled,
}

impl Axes {
    /// A core, a port and a source of handles for each axis.
    pub fn open(
        devices: &[Device],
        control: Arc<Control>,
        wakes: &Wakes,
        log: Log,
    ) -> (Self, Vec<AxisSource>) {
        let queue = GroupQueue::with(wakes);
        let mut axes = Vec::new();
        let mut held = Vec::new();
        let mut sources = Vec::new();
        let mut recorded = Vec::new();
        let mut lags = Vec::new();
        let mut logged = Vec::new();
        for (place, device) in devices.iter().enumerate() {
            let (Some(drive), Some(mailbox)) = (device.as_drive(), &device.mailbox) else {
                continue;
            };
            for axis in &drive.axes {
                let mut core = AxisCore::new(axis.config.clone());
                core.await_op(true);
                let identity = AxisIdentity {
                    axis: axis.name.clone(),
                    drive: device.found.id.clone(),
                };
                logged.push((identity.clone(), axis.scale));
                let lag = obj::FOLLOWING_ERROR_ACTUAL.offset(axis.offset);
                if let Some(level) = axis.following_error_warning
                    && let Ok(field) = drive.layout.input(lag)
                {
                    lags.push(LagWatch {
                        axis: Arc::new(identity.clone()),
                        scale: axis.scale,
                        drive: place,
                        field,
                        level,
                        is_high: false,
                        high: None,
                    });
                }
                recorded.push(RecordedAxis {
                    identity: identity.clone(),
                    drive: place,
                    fields: axis.config.fields,
                });
                let setup = AxisSetup {
                    identity,
                    offset: axis.offset,
                    fields: axis.config.fields,
                    scale: axis.scale,
                    layout: drive.layout.clone(),
                    parameters: Arc::new(Parameters(mailbox.sdo.clone())),
                    error_texts: Arc::clone(&mailbox.error_texts),
                    groups: queue.clone(),
                    index: axes.len(),
                };
                let (source, mut port) = setup.open(&core);
                port.know_counters();
                sources.push(source);
                let is_declared = matches!(axis.config.brake, Some(Brake::Output(_)));
                let brake = drive.layout.find(
                    Direction::Outputs,
                    axis.offset.apply(obj::DIGITAL_OUTPUTS.index()),
                    obj::DIGITAL_OUTPUTS.subindex(),
                );
                axes.push(RunningAxis {
                    drive: place,
                    core,
                    port,
                    brake: brake
                        .filter(|_| !is_declared)
                        .map(|outputs| UndeclaredBrake {
                            bit: BitRange { bits: 1, ..outputs },
                            is_set_for_good: false,
                            patience: axis.config.deadlines.standstill,
                        }),
                    leaving: Leaving::No,
                });
            }
            held.push((place, drive.held.clone()));
        }
        let running = Self {
            axes,
            held,
            has_ended: false,
            groups: queue.groups(),
            cycles: 0,
            watch: None,
            expired: false,
            transitions: TransitionLog::new(logged.into_iter(), log),
            recorded,
            lags,
            control,
            disabling: None,
            was_doubted: false,
        };
        (running, sources)
    }

    /// The axes of the drive at this place begin again, with what was read of each where their drive holds that anew.
    pub fn restart(
        &mut self,
        now: Duration,
        place: usize,
        mut again: impl FnMut(usize) -> Reattach,
        drives: &mut Drives,
    ) {
        let Some(outputs) = drives.outputs_mut(place) else {
            return;
        };
        // As at the beginning, also what no axis writes.
        if let Some((_, held)) = self.held.iter().find(|(drive, _)| *drive == place) {
            held.begin(outputs);
        }
        for (number, axis) in self.of_drive(place).enumerate() {
            axis.port
                .restart(&mut axis.core, now, again(number), outputs);
        }
    }

    /// The drive at this place was without power: its axes do not know where they are.
    pub fn forget(&mut self, place: usize) {
        self.of_drive(place).for_each(|axis| axis.core.forget());
    }

    /// The drive at this place is not in the line, or is again. Of one that has gone nobody waits for its axes at the end.
    pub fn set_absent(&mut self, place: usize, is_absent: bool) {
        self.of_drive(place)
            .for_each(|axis| axis.port.set_absent(is_absent));
    }

    /// Whether the drive at this place is of an optional group that is not in the line.
    pub fn is_absent(&self, place: usize) -> bool {
        let mut axes = self.axes.iter();
        axes.any(|axis| axis.drive == place && axis.port.is_absent())
    }

    /// The drive at this place begins with these outputs from now on.
    pub fn hold(&mut self, place: usize, held: HeldOutputs) {
        let mut places = self.held.iter_mut();
        if let Some((_, before)) = places.find(|(drive, _)| *drive == place) {
            *before = held;
        }
    }

    /// The drive at this place shows of the axis with this number that it is not homed.
    pub fn forget_axis(&mut self, place: usize, number: usize) {
        if let Some(axis) = self.of_drive(place).nth(number) {
            axis.core.forget();
        }
    }

    /// The drive at this place has kept its power.
    pub fn recall_homing(&mut self, place: usize) {
        self.of_drive(place)
            .for_each(|axis| axis.core.recall_homing());
    }

    /// The axes of the drive at this place, in its order.
    fn of_drive(&mut self, place: usize) -> impl Iterator<Item = &mut RunningAxis> {
        self.axes.iter_mut().filter(move |axis| axis.drive == place)
    }

    /// All drives are in OP.
    pub fn in_op(&mut self) {
        for axis in &mut self.axes {
            axis.core.await_op(false);
        }
    }

    /// Whether the drive at this place takes the outputs of its axes, and none of them is enabled that the program has not enabled
    /// since: it may do so as soon as the axis is not lost any more.
    pub fn are_back(&self, place: usize) -> bool {
        let axes = self.axes.iter().filter(|axis| axis.drive == place);
        axes.map(|axis| axis.core.snapshot()).all(|axis| {
            let is_told = axis.controlword.contains(Controlword::ENABLE_OPERATION);
            !axis.lost && (axis.state != State::OperationEnabled || is_told)
        })
    }

    /// Disables all axes for good; moving ones are stopped before, by halt and quick stop.
    pub const fn disable(&mut self, cause: Failure) {
        self.disabling = Some(cause);
    }

    /// The axes that may be moving: what answers and is powered or does not stand, and what does not answer and was so when it did last.
    pub fn moving(&self) -> impl Iterator<Item = MovingAxis> {
        let all = self.axes.iter().zip(&self.recorded);
        let there = all.filter(|(axis, _)| !axis.port.is_absent());
        there.filter_map(move |(axis, recorded)| {
            let snapshot = axis.core.snapshot();
            let answers = snapshot.answered || !snapshot.lost;
            let stands = axis.core.stands();
            let powered = matches!(
                snapshot.state,
                State::SwitchedOn
                    | State::OperationEnabled
                    | State::QuickStopActive
                    | State::FaultReactionActive
            );
            let may_move = !stands || (answers && powered);
            may_move.then(|| MovingAxis {
                axis: recorded.identity.clone(),
                state: snapshot.state,
                position: snapshot.position,
                stands,
                answers,
            })
        })
    }

    /// From now on digital outputs and makers' objects are what they were before the program set them.
    pub const fn end(&mut self) {
        self.has_ended = true;
    }

    /// How long it may take until the slowest axis stands and is disabled; before that, with a brake, a halt, and the time in which that
    /// closes.
    pub fn longest_stop(&self) -> Duration {
        let stops = self.axes.iter().map(|axis| {
            let brake = axis.brake.as_ref();
            let brakes = brake.map(|brake| brake.patience.saturating_add(BRAKE_CLOSES_IN));
            axis.core
                .longest_stop()
                .saturating_add(brakes.unwrap_or_default())
        });
        stops.max().unwrap_or_default()
    }

    /// Which levels were passed since the last time.
    pub fn next_passed(&mut self) -> Option<NetworkEvent> {
        let skew = self.groups.next_skew_report();
        let skew = skew.map(|report| NetworkEvent::Skew(Arc::new(report)));
        skew.or_else(|| self.lags.iter_mut().find_map(LagWatch::take_event))
    }

    /// What came upon which axis since the last time.
    pub fn take_incidents(&mut self) -> Vec<(usize, AxisIncident)> {
        self.transitions.take_incidents().collect()
    }

    /// The last cycles of the axis at this place.
    pub fn black_box(
        &self,
        index: usize,
        incident: Option<AxisIncident>,
        history: impl Fn(&RecordedAxis) -> Vec<RecordedCycle>,
    ) -> Option<BlackBox> {
        let axis = self.recorded.get(index)?;
        Some(BlackBox {
            axis: axis.identity.clone(),
            incident,
            cycles: history(axis),
        })
    }

    /// What goes out whatever a handle of any axis sets.
    fn write_last_outputs(&self, drives: &mut Drives) {
        for axis in &self.axes {
            if let Some(brake) = axis.brake.as_ref().filter(|brake| brake.is_set_for_good)
                && let Some(outputs) = drives.outputs_mut(axis.drive)
            {
                // An image that is too short is the exchange's error, and shows there.
                let _ = brake.bit.write(outputs, 1);
            }
        }
        for (place, held) in self.held.iter().filter(|_| self.has_ended) {
            if let Some(outputs) = drives.outputs_mut(*place) {
                held.end(outputs);
            }
        }
    }

    fn stop(&mut self, now: Duration) -> StopRequest {
        while let Some(watch) = self.control.take_watch() {
            self.watch = Some(watch);
        }
        let mut stop = self.control.take_stop();
        self.transitions.stop_of_all(now, stop);
        let expired = self.watch.as_mut().is_some_and(|watch| watch.expired(now));
        if expired != self.expired {
            self.expired = expired;
            self.transitions.liveness(now, expired);
            for axis in &mut self.axes {
                axis.core.set_expired(expired);
            }
            if expired {
                stop |= StopRequest::HALT;
            }
        }
        stop
    }
}

impl Stepper for Rc<RefCell<Axes>> {
    fn before_send(&mut self, now: Duration, drives: &mut Drives) {
        let this = &mut *self.borrow_mut();
        let stop = this.stop(now);
        let disable = this.disabling;
        // Else there is nothing to take in for any axis.
        if this.groups.take_asked() || disable.is_some() || !stop.is_empty() {
            for axis in &mut this.axes {
                axis.take_in(now, stop, disable, drives);
            }
            if disable.is_some() {
                this.write_last_outputs(drives);
            }
        }
        let mut set = Set {
            axes: &mut this.axes,
            drives,
        };
        this.groups.advance(now, &mut set);
    }

    fn after_receive(&mut self, now: Duration, drives: &mut Drives) {
        let this = &mut *self.borrow_mut();
        let is_doubted = drives.take_doubted();
        if is_doubted || this.was_doubted {
            this.was_doubted = is_doubted;
            for axis in &mut this.axes {
                let left_op = drives.get(axis.drive).and_then(|drive| drive.left_op);
                axis.port.note_doubt(drives.miscounted(axis.drive), left_op);
            }
        }
        for (index, axis) in this.axes.iter_mut().enumerate() {
            let core = &mut axis.core;
            let step = |inputs: Inputs<'_>, unchanged: bool, outputs: &mut [u8]| {
                if unchanged && core.rests_at(now, &inputs) {
                    return None;
                }
                core.count_to(this.cycles);
                Some(core.step_kept(now, inputs, unchanged, outputs))
            };
            let Some(change) = drives.step(axis.drive, step) else {
                continue;
            };
            if let Some(snapshot) = axis.port.pass(&mut axis.core, change)
                && !axis.port.is_absent()
            {
                this.transitions.look(now, index, &snapshot);
            }
        }
        for lag in &mut this.lags {
            lag.look(drives);
        }
        this.cycles = this.cycles.wrapping_add(1);
        this.groups.count_to(this.cycles);
        // Once for all of them.
        stored();
        if this.groups.are_watched() {
            for axis in &mut this.axes {
                axis.port.wake();
            }
        }
    }
}

impl RunningAxis {
    /// Lets the core take in what was asked of the axis, and what is asked of all.
    fn take_in(
        &mut self,
        now: Duration,
        stop: StopRequest,
        disable: Option<Failure>,
        drives: &mut Drives,
    ) {
        if !stop.is_empty() {
            self.port.request_stop(stop);
        }
        let is_disabled_now = disable.is_some_and(|cause| {
            self.port.end_because(cause);
            self.leave(now)
        });
        if !(is_disabled_now || self.port.is_asked()) {
            return;
        }
        let Some(outputs) = drives.outputs_mut(self.drive) else {
            return;
        };
        if self.port.is_asked() {
            self.port.before_send(&mut self.core, now, outputs);
        }
        if is_disabled_now {
            self.core
                .submit(now, OWN_COMMAND, Command::Disable, outputs);
        }
    }

    /// Takes the next step to be disabled for good. Whether the core is to take that in this cycle.
    fn leave(&mut self, now: Duration) -> bool {
        if !self.core.takes_stops() {
            self.leaving = Leaving::No;
            return false;
        }
        let is_powered = self.core.state().holds_axis();
        let brake = self.brake.as_mut().filter(|_| is_powered);
        self.leaving = match (self.leaving, brake) {
            (Leaving::Disabled, _) => return false,
            (Leaving::No, Some(brake)) if !brake.is_set_for_good => {
                self.port.request_stop(StopRequest::HALT);
                let until = now.saturating_add(brake.patience);
                Leaving::Halting { until }
            }
            (Leaving::Halting { until }, Some(_)) if !self.core.stands() && now < until => {
                Leaving::Halting { until }
            }
            (Leaving::Halting { .. }, Some(brake)) => {
                brake.is_set_for_good = true;
                let until = now.saturating_add(BRAKE_CLOSES_IN);
                Leaving::Braking { until }
            }
            (Leaving::Braking { until }, Some(_)) if now < until => Leaving::Braking { until },
            _ => {
                if let Some(brake) = &mut self.brake {
                    brake.is_set_for_good = true;
                }
                self.leaving = Leaving::Disabled;
                return true;
            }
        };
        false
    }
}

struct Set<'a> {
    axes: &'a mut [RunningAxis],
    drives: &'a mut Drives,
}

impl AxisSet for Set<'_> {
    fn axis(&mut self, index: usize) -> Option<(&mut AxisCore, &mut [u8])> {
        let axis = self.axes.get_mut(index)?;
        Some((&mut axis.core, self.drives.outputs_mut(axis.drive)?))
    }
}
