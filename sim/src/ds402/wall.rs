//! What the axis presses against: an elastic wall in its way, peaks of friction, and the torque limits (6072h, 60E0h, 60E1h).
//! Torques are in thousandths of the rated one, positive toward larger positions.

use core::time::Duration;

use super::axis::Axis;
use super::objects;

/// Least and greatest stiffness, in thousandths of the rated torque per count.
const STIFFNESS: (f64, f64) = (1e-6, 1e6);

/// An elastic wall.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wall {
    /// Where the shaft touches it, in counts.
    at: i64,
    stiffness: f64,
    /// 1 for a wall that stops positive motion, −1 for one that stops negative motion.
    side: f64,
}

/// What acts on the shaft in one cycle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contact {
    wall: Option<Wall>,
    /// What the motor gives at most in negative and in positive direction, both without a sign.
    limits: (f64, f64),
    /// What friction asks of the motor beside the motion.
    pub(super) peak: f64,
}

impl Wall {
    /// How far behind its face a position is.
    fn depth(&self, position: f64) -> f64 {
        self.side * (position - self.at as f64)
    }
}

impl Contact {
    /// Position and torque of a shaft that would be at `free` without the wall; none where it does not touch the wall. The
    /// loop asks for a torque that grows with the following error by 1/`compliance`, up to the limit, and the wall gives way by
    /// as much. A shaft that lags the demand is no deeper than without the wall.
    pub(super) fn press(&self, free: f64, demand: f64, compliance: f64) -> Option<(f64, f64)> {
        let wall = self.wall.filter(|wall| wall.depth(free) > 0.0)?;
        let asked = wall.depth(demand).max(0.0) * wall.stiffness;
        let torque = self.limited(wall.side * asked / (1.0 + compliance * wall.stiffness));
        let depth = (torque.abs() / wall.stiffness).min(wall.depth(free));
        let position = wall.at as f64 + wall.side * depth;
        Some((position, wall.side * depth * wall.stiffness))
    }

    /// A torque within the limits.
    pub(super) fn limited(&self, torque: f64) -> f64 {
        torque.max(-self.limits.0).min(self.limits.1)
    }
}

impl Axis {
    /// Puts an elastic wall into the way of the axis, in place of the one that is there. `at` is where the shaft touches it, in
    /// counts as [`Axis::position`] has now; it stops motion from the side on which the shaft is now. `stiffness` is in
    /// thousandths of the rated torque per count, within 10⁻⁶ and 10⁶. A homing does not move the wall, nor does a power failure.
    ///
    /// Behind `at` the shaft is where the force of the wall and the torque of the loop balance. 6077h shows that torque, 60F4h what
    /// is left to the demand. The limits 6072h, 60E0h and 60E1h end the torque. An axis without power is pushed back to `at`.
    ///
    /// ```
    /// use core::time::Duration;
    /// use servocrab_sim::ds402::{Axis, Behaviour};
    ///
    /// let mut axis = Axis::new(Behaviour::generic());
    /// axis.put_wall(40_000, 0.5);
    /// axis.set(0x6060, 0, 1)?;
    /// axis.set(0x607A, 0, 50_000)?;
    /// axis.set(0x6072, 0, 300)?;
    /// let mut now = Duration::ZERO;
    /// for controlword in [0x00, 0x06, 0x07, 0x0F, 0x1F] {
    ///     axis.set(0x6040, 0, controlword)?;
    ///     for _ in 0..400 {
    ///         now += Duration::from_millis(1);
    ///         axis.cycle(now);
    ///     }
    /// }
    /// // 300 ‰ press the wall in by 600 counts.
    /// assert_eq!((axis.position(), axis.get(0x6077, 0)), (40_600, Some(300)));
    /// # Ok::<(), servocrab_sim::ds402::SetError>(())
    /// ```
    pub fn put_wall(&mut self, at: i64, stiffness: f64) {
        let side = if at >= self.position() { 1.0 } else { -1.0 };
        self.wall = Some(Wall {
            at: at.saturating_add(self.machine_offset),
            stiffness: stiffness.max(STIFFNESS.0).min(STIFFNESS.1),
            side,
        });
    }

    /// Takes the wall away. An axis that pressed against it goes to its demand at once.
    pub fn take_wall_away(&mut self) {
        self.wall = None;
    }

    /// For `duration` the motor needs `torque` more, in thousandths of the rated one, as of friction that grips: 6077h shows it
    /// within the limits. The axis does not move of it. Only with power; another peak takes the place of this one.
    pub fn inject_torque_peak(&mut self, torque: i16, duration: Duration) {
        self.torque_peak = Some((torque, self.now.saturating_add(duration)));
    }

    /// What acts on the shaft in this cycle.
    pub(super) fn contact(&self) -> Contact {
        let limit = |direction| {
            let most = self.objects.limit(objects::MAX_TORQUE);
            most.min(self.objects.limit(direction)) as f64
        };
        let peak = self.torque_peak.filter(|(_, until)| self.now <= *until);
        Contact {
            wall: self.wall_here(),
            limits: (
                limit(objects::NEGATIVE_TORQUE_LIMIT),
                limit(objects::POSITIVE_TORQUE_LIMIT),
            ),
            peak: match peak {
                Some((torque, _)) if self.state.controls() => torque.into(),
                _ => 0.0,
            },
        }
    }

    /// The face of the wall where the demand of an axis without power is behind it.
    pub(super) fn pushed_back_to(&self) -> Option<i64> {
        let wall = self.wall_here()?;
        (wall.depth(self.trajectory.position()) > 0.0).then_some(wall.at)
    }

    /// The wall in reported counts.
    fn wall_here(&self) -> Option<Wall> {
        let wall = self.wall?;
        let at = wall.at.saturating_sub(self.machine_offset);
        Some(Wall { at, ..wall })
    }
}
