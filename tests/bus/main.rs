//! The network against a simulated segment, in virtual time and without a thread.

mod bring_up;
mod bring_up_costs;
#[path = "../common/cable.rs"]
mod cable;
mod clocks;
mod clocks_again;
mod clocks_trouble;
mod endings;
mod expected_line;
mod faults;
mod habits;
mod held;
mod independent;
mod io;
mod limits;
mod load;
mod log;
mod mappings;
mod messages;
mod modes;
mod otherwise;
mod own_time;
mod parameters;
mod recovery;
mod refused;
mod rest;
mod rig;
mod scale;
mod scan;
mod sdo;
mod sharing;
mod start_up;
mod statistics;
mod stops;
mod threaded;
mod timing;
