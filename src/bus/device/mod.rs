//! One device: what a program declares of it, its way from PREOP to SAFEOP, and the handles of an I/O device's inputs and outputs.
//!
//! `config` and `io` are what a program says and holds. `drive` and `io_setup` do the same steps for the two kinds of devices, for the
//! first start and for a recovery. It calls `clocks`, `line` and `requests`. It must not know of other devices, of cycles that
//! run, or of the network.

pub(super) mod config;
pub(super) mod drive;
pub(super) mod io;
mod io_cell;
pub(super) mod io_points;
pub(super) mod io_port;
pub(super) mod io_setup;
pub(super) mod progress;
