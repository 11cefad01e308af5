//! Devices that exist, as data: what they say about themselves and what makes them different.

mod akd2g;
mod coupler;
mod io_terminal;

pub use akd2g::{Akd2g, akd2g};
pub use coupler::coupler;
pub use io_terminal::io_terminal;
