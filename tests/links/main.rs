//! Real links and real time: the library's raw socket on one end of a veth pair, and the bus thread as the system shows it.
#![allow(missing_docs)]
#![cfg(target_os = "linux")]

#[path = "../common/namespace.rs"]
mod namespace;

mod frames;
mod programs;
mod real_time;
