//! The DS402 axis of a simulated drive: device state machine, profile position, profile velocity and homing mode,
//! trajectory, and ledgers of what it executed.
//!
//! The model is pure: the segment around it writes objects ([`Axis::set`]), calls [`Axis::cycle`] once per drive cycle,
//! and reads objects ([`Axis::get`]). How one drive differs from another is data ([`Behaviour`]).
//!
//! ```
//! use core::time::Duration;
//! use servocrab_sim::ds402::{Axis, Behaviour, Outcome};
//!
//! let mut axis = Axis::new(Behaviour::akd2g());
//! axis.set(0x6060, 0, 1)?;
//! axis.set(0x607A, 0, 5000)?;
//! let mut now = Duration::ZERO;
//! for controlword in [0x00, 0x06, 0x07, 0x0F, 0x1F] {
//!     axis.set(0x6040, 0, controlword)?;
//!     for _ in 0..200 {
//!         now += Duration::from_millis(1);
//!         axis.cycle(now);
//!     }
//! }
//! assert_eq!(axis.position(), 5000);
//! assert_eq!(axis.ledger()[0].outcome, Outcome::Reached);
//! # Ok::<(), servocrab_sim::ds402::SetError>(())
//! ```

mod axis;
mod behaviour;
mod buffer;
mod emergency;
mod entries;
mod hanging;
mod homing;
mod homing_method;
mod ledger;
mod machine;
mod motion;
mod objects;
mod plant;
mod positioning;
mod power;
mod presets;
mod ramp;
mod rotary;
mod set_point;
mod state;
mod status;
mod touch_probe;
mod trajectory;
mod units;
mod velocity;
mod wall;

pub use axis::{AckFault, Axis, Disturbances};
pub use behaviour::{
    AckPolicy, Behaviour, Bit5, FactorChange, FollowingError, FullBuffer, HOMING_METHODS,
    HomeOffset, LimitSwitches, LimitViolation, LimitsOff, ModeZero, ReachedPolicy, RelativeBase,
    WhileHalted, WhileMoving,
};
pub use emergency::Emergency;
pub use ledger::{
    Cause, Executed, Homing, HomingError, HomingOutcome, Outcome, VelocityEnd, VelocityPhase,
};
pub use machine::{Machine, MachineBrake, Mark, Opener};
pub use objects::{Access, DataType, Entry, Mapping, SetError};
pub use plant::Plant;
pub use state::State;

#[cfg(test)]
mod tests;
