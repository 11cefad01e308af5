//! Bytes of real drives, recorded by other people: the library reads them, and the simulated drives speak as they do.
//! The bytes stand in `tests/vectors/`, each file with its source.

mod answers;
mod dictionary;
mod drive;
mod information;
mod messages;
mod registers;
mod sii;
mod vectors;
