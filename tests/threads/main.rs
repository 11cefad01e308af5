//! The library in the threads of a program, in real time: nothing that a program or its log does holds up a cycle.
#![allow(missing_docs, unsafe_code)]

#[path = "../common/counting.rs"]
mod counting;

mod attacks;
mod logging;
