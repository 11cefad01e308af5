//! What simulated axes did, recorded and drawn; shared by the examples that draw.
#![allow(dead_code, reason = "each example uses its own part")]

mod panel;
mod plot;
mod recorder;

pub(crate) use panel::{Mark, Panel, Row, Step};
pub(crate) use plot::{Bit, Picture, Word};
pub(crate) use recorder::Recorder;

use std::sync::{Mutex, MutexGuard, PoisonError};

pub(crate) fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
