//! A load that hangs on the axis, and the holding brake that keeps it: on an output (60FEh), or managed by the drive.

use core::time::Duration;

use super::axis::Axis;
use super::machine::Opener;
use super::objects;
use super::state::State;

/// The brake of an axis. At power-up it is closed.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct HoldingBrake {
    is_open: bool,
    /// Since when it is to be otherwise.
    since: Option<Duration>,
    /// The drive is about to control the axis, and opens its brake before it does.
    pub(super) is_asked: bool,
}

impl Axis {
    /// Opens and closes the brake as the outputs say, or the drive.
    pub(super) fn run_brake(&mut self) {
        let Some(machine) = self.behaviour.machine.brake else {
            return;
        };
        let released = match machine.opened_by {
            Opener::Output {
                bit,
                level,
                closed_by_drive,
            } => {
                let at = |address| self.objects.value(address) >> bit & 1 != 0;
                let is_faulty = matches!(self.state, State::FaultReactionActive | State::Fault);
                let is_cut = closed_by_drive && (is_faulty || !self.connected);
                !is_cut && at(objects::DIGITAL_OUTPUT_MASK) && at(objects::DIGITAL_OUTPUTS) == level
            }
            Opener::Drive => self.state.controls() || self.brake.is_asked,
        };
        let brake = &mut self.brake;
        if released == brake.is_open {
            brake.since = None;
            return;
        }
        let since = *brake.since.get_or_insert(self.now);
        let takes = if released {
            machine.opens_in
        } else {
            machine.closes_in
        };
        if self.now.saturating_sub(since) >= takes && !self.disturbances.brake_sticks {
            brake.is_open = released;
            brake.since = None;
        }
    }

    /// Whether the brake keeps the shaft from turning.
    pub fn is_braked(&self) -> bool {
        self.behaviour.machine.brake.is_some() && !self.brake.is_open
    }

    /// Whether a drive that opens the brake itself may control the axis now.
    pub(super) fn has_released_brake(&mut self) -> bool {
        let brake = self.behaviour.machine.brake;
        if brake.is_none_or(|brake| brake.opened_by != Opener::Drive) {
            return true;
        }
        self.brake.is_asked = true;
        self.brake.is_open
    }

    /// Whether the drive, which controls the axis no more or not yet, carries the load until its brake is closed or open: for the time that
    /// the brake takes. Without supply it cannot.
    fn carries_load(&self) -> bool {
        let Some(brake) = self.behaviour.machine.brake else {
            return false;
        };
        let closes = |since: Duration| self.now.saturating_sub(since) < brake.closes_in;
        let has_power = self.voltage && !self.inhibited;
        let is_asked = self.brake.is_asked || self.brake.since.is_none_or(closes);
        brake.opened_by == Opener::Drive && self.brake.is_open && has_power && is_asked
    }

    /// An axis that no drive controls, for one period: its brake holds it, or it falls. True where it did either.
    ///
    /// While the drive controls the axis its position loop carries the load.
    pub(super) fn hang(&mut self) -> bool {
        let gravity = f64::from(self.behaviour.machine.gravity);
        if self.state.controls() || self.carries_load() {
            return false;
        }
        if self.is_braked() {
            self.put_down(self.shaft.counts);
            return true;
        }
        if gravity == 0.0 {
            return false;
        }
        let time = self.behaviour.period.as_secs_f64();
        let velocity = self.trajectory.velocity();
        let faster = velocity - gravity * time;
        let position = self.trajectory.position() + 0.5 * (velocity + faster) * time;
        let counts = position.round() as i64;
        let end = self.within_ends(counts);
        if end == counts {
            self.trajectory.catch(position, faster);
        } else {
            self.put_down(end);
        }
        true
    }

    pub(super) fn put_down(&mut self, position: i64) {
        self.trajectory.place(position);
        self.lagging.clear();
    }
}
