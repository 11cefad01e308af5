//! All axes of a network in the cycle: commands in, stops last, groups together, cores stepped, reports out.

use std::{cell::RefCell, rc::Rc, sync::Arc, time::Duration};

use crate::{
    axis::{
        AxisCore, AxisIdentity, AxisPort, AxisSet, AxisSetup, AxisSource, Command, CommandId,
        Failure, GroupQueue, Groups, Inputs, LivenessWatch, Reattach, StopRequest,
    },
    bus::{
        cycle::{
            Drives, Stepper,
            black_box::{AxisIncident, BlackBox, RecordedAxis, RecordedCycle},
        },
        device::{Device, drive::Parameters},
        error::MovingAxis,
        log::Log,
        watch::{Control, TransitionLog},
    },
    ds402::{Controlword, State},
    wakes::{Wakes, stored},
};

/// The command by which the network itself disables an axis: no handle gives this number.
const OWN_COMMAND: CommandId = CommandId(u32::MAX);

/// The axes of a network.
pub(in crate::bus) struct Axes {
    axes: Vec<RunningAxis>,
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
    control: Arc<Control>,
}

struct RunningAxis {
    /// The place of its drive in the exchange.
    drive: usize,
    core: AxisCore,
    port: AxisPort,
    /// Whether its core has taken that it is disabled for good. One that is silent takes nothing, and drops what it was asked for.
    is_disabled: bool,
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
        let mut sources = Vec::new();
        let mut recorded = Vec::new();
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
                    groups: queue.clone(),
                    index: axes.len(),
                };
                let (source, mut port) = setup.open(&core);
                port.know_counters();
                for &(object, raw) in &axis.outputs {
                    port.hold(object, raw);
                }
                sources.push(source);
                axes.push(RunningAxis {
                    drive: place,
                    core,
                    port,
                    is_disabled: false,
                });
            }
        }
        let running = Self {
            axes,
            groups: queue.groups(),
            cycles: 0,
            watch: None,
            expired: false,
            transitions: TransitionLog::new(logged.into_iter(), log),
            recorded,
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
        // As at the beginning: also what no axis writes is 0, or what the drive held, until it is set.
        outputs.fill(0);
        for (number, axis) in self.of_drive(place).enumerate() {
            axis.port
                .restart(&mut axis.core, now, again(number), outputs);
        }
    }

    /// The drive at this place was without power: its axes do not know where they are.
    pub fn forget(&mut self, place: usize) {
        self.of_drive(place).for_each(|axis| axis.core.forget());
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

    /// What only motion needs has been read of all drives. Nobody has a handle of their axes before.
    pub fn know(&mut self, devices: &[Device]) {
        let drives = devices.iter().filter_map(Device::as_drive);
        let known = drives.flat_map(|drive| &drive.axes);
        for (axis, known) in self.axes.iter_mut().zip(known) {
            axis.port.know(&mut axis.core, known.config.clone());
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
        all.filter_map(move |(axis, recorded)| {
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

    /// How long it may take until the slowest axis stands and is disabled.
    pub fn longest_stop(&self) -> Duration {
        let stops = self.axes.iter().map(|axis| axis.core.longest_stop());
        stops.max().unwrap_or_default()
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
                if unchanged && core.rests_at(&inputs) {
                    return None;
                }
                core.count_to(this.cycles);
                Some(core.step_kept(now, inputs, unchanged, outputs))
            };
            let Some(change) = drives.step(axis.drive, step) else {
                continue;
            };
            if let Some(snapshot) = axis.port.pass(&mut axis.core, change) {
                this.transitions.look(now, index, &snapshot);
            }
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
        if let Some(cause) = disable {
            self.port.end_because(cause);
        }
        if !(disable.is_some() || self.port.is_asked()) {
            return;
        }
        let Some(outputs) = drives.outputs_mut(self.drive) else {
            return;
        };
        if self.port.is_asked() {
            self.port.before_send(&mut self.core, now, outputs);
        }
        if disable.is_some() {
            let takes = self.core.takes_stops();
            if takes && !self.is_disabled {
                self.core
                    .submit(now, OWN_COMMAND, Command::Disable, outputs);
            }
            self.is_disabled = takes;
        }
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
