//! The targets and the inputs to begin with are those of the library's tests, which run them too.

#[path = "../../tests/decoders/seeds.rs"]
pub mod seeds;
#[path = "../../tests/decoders/targets/mod.rs"]
pub mod targets;
