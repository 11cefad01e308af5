//! Devices that exist, as data: what they say about themselves and what makes them different.

mod akd2g;
mod ax2000;
mod coupler;
mod generic;
mod io_terminal;
mod pp2010;
mod servo;
mod servo_pdos;
mod sigma7;

pub use akd2g::akd2g;
pub use ax2000::ax2000;
pub use coupler::coupler;
pub use generic::generic;
pub use io_terminal::{digital_inputs, digital_outputs, io_terminal};
pub use pp2010::pp2010;
pub use servo::Servo;
pub use sigma7::sigma7;
