//! Bytes of real drives, recorded by other people: the library reads them, and the simulated drives speak as they do.
//! The bytes stand in `tests/vectors/`, each file with its source.
#![cfg(feature = "std")]
#![allow(missing_docs)]

mod answers;
#[path = "../common/datagrams.rs"]
mod datagrams;
mod dictionary;
mod drive;
mod information;
mod messages;
mod registers;
mod sii;
mod vectors;
