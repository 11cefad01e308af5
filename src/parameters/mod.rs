//! Parameters of drives, as data: start-up lists.
//!
//! A [`StartUpList`] is written to a drive each time on its way to OP. With the feature `files` lists are read from TOML
//! files, with errors that name file, line, drive and object.

#[cfg(feature = "files")]
mod file;
mod start_up;
mod value;

#[cfg(feature = "files")]
pub use file::{FileError, FileFault, LONGEST_FILE};
pub use start_up::{
    StartUpError, StartUpList, StartUpWrite, Transition, UnknownTransition, WriteFault,
};
pub use value::{ObjectValue, UnknownType, ValueType};
