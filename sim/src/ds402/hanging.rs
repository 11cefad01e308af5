//! A load that hangs on the axis, and the holding brake that keeps it (60FEh).

use core::time::Duration;

use super::axis::Axis;
use super::objects;

/// Bit 0 of 60FEh: set brake in subindex 1, and whether that output is enabled in subindex 2.
const SET_BRAKE: i64 = 1;

/// The brake of an axis. At power-up it is closed.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct HoldingBrake {
    is_open: bool,
    /// Since when the drive does not open it any more.
    set_since: Option<Duration>,
}

impl Axis {
    /// Opens and closes the brake as the outputs say.
    pub(super) fn run_brake(&mut self) {
        let Some(closes_in) = self.behaviour.machine.brake else {
            return;
        };
        let bit = |address| self.objects.value(address) & SET_BRAKE != 0;
        let released = bit(objects::DIGITAL_OUTPUT_MASK) && !bit(objects::DIGITAL_OUTPUTS);
        let brake = &mut self.brake;
        if released {
            brake.is_open = true;
            brake.set_since = None;
        } else {
            let since = *brake.set_since.get_or_insert(self.now);
            brake.is_open &= self.now.saturating_sub(since) < closes_in;
        }
    }

    /// Whether the brake keeps the shaft from turning.
    pub fn is_braked(&self) -> bool {
        self.behaviour.machine.brake.is_some() && !self.brake.is_open
    }

    /// An axis that no drive controls, for one period: its brake holds it, or it falls. True where it did either.
    ///
    /// While the drive controls the axis its position loop carries the load.
    pub(super) fn hang(&mut self) -> bool {
        let gravity = f64::from(self.behaviour.machine.gravity);
        if self.state.controls() {
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
