//! CANopen over EtherCAT: typed objects, the SDO codec, the mailbox client, emergencies.
//!
//! Pure: [`object`] and [`obj`] (the objects), [`mailbox`], [`sdo`], [`emergency`] and [`abort`] (bytes and
//! transfers without I/O), [`error`]. With `std`: the mailbox client, one per device, and its transport.

pub mod abort;
pub mod emergency;
pub mod error;
pub mod mailbox;
pub mod obj;
pub mod object;
pub mod sdo;

pub use abort::AbortCode;
pub use emergency::Emergency;
pub use error::{DriveError, DriveId, SdoError, SdoStep, Transfer, TransferKind};
pub use mailbox::MailboxError;
pub use object::{
    Access, AnyObject, AxisOffset, DataType, Mappable, Number, Object, ObjectAddress, ReadOnly,
    ReadWrite, Readable, Unit, Value, Writable, WriteOnly,
};
