//! Axis cores and simulated drives in virtual time, without frames: what a set-point, a stop, a state and a late word lead to. The drive's
//! ledger judges.
#![allow(missing_docs)]

#[path = "../common/mod.rs"]
mod common;
#[path = "../common/plant.rs"]
mod plant;

use common::{differential, frames};

mod against_traits;
mod arithmetic;
mod drives;
mod enabling;
mod holding;
mod lagging;
mod matrix;
mod modulo;
mod motion_table;
mod moves;
mod overriding;
mod pressing;
mod sightings;
mod standstill;
mod start_bits;
mod stops;
mod vectors;
mod wrong_words;
