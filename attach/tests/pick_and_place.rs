//! The tests that the example `pick_and_place` has of its machine: cargo builds an example that is a test itself as nothing else.
#![allow(missing_docs)]

#[expect(dead_code, reason = "its program is the example")]
#[path = "../examples/pick_and_place.rs"]
mod example;
