//! Parameters of drives, as data: start-up lists, backups, and what the drives store themselves.
//!
//! A [`StartUpList`] is written to a drive each time on its way to OP. A [`ParameterSet`] is what a drive holds: read from it,
//! compared with it, restored to it. [`store`] and [`load_defaults`] use the drive's own memory. With the feature `files`
//! lists and sets are TOML files, with errors that name file, line, drive and object.
//!
//! While an axis of the drive is enabled nothing of it is restored, stored or set back.

#[cfg(feature = "files")]
mod file;
mod restore;
mod set;
mod start_up;
mod value;

#[cfg(feature = "files")]
pub use file::{FileError, FileFault, LONGEST_FILE, NewFile};
pub use restore::{
    Enabled, MemoryError, MemoryFault, MemorySupport, RestoreError, RestoreFault, Restored,
    defaults_support, load_defaults, store, store_support,
};
pub(crate) use restore::{Guard, GuardFault};
pub use set::{
    Backup, Difference, Differences, Held, Parameter, ParameterObject, ParameterSet, Progress,
    is_parameter,
};
pub(crate) use start_up::StartUpLines;
pub use start_up::{
    StartUpError, StartUpList, StartUpWrite, Transition, UnknownTransition, WriteFault,
};
pub use value::{ObjectValue, UnknownType, ValueType};
