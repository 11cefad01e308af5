//! CANopen over EtherCAT: typed objects, the SDO codec, the mailbox client, emergencies.
//!
//! Pure: [`object`], [`value`] and [`obj`] (the objects), [`mailbox`], [`sdo`], [`information`], [`emergency`] and
//! [`abort`] (bytes and transfers without I/O), [`error`]. With `std`: the mailbox client, one per device, and its transport.

pub mod abort;
#[cfg(feature = "std")]
mod calls;
#[cfg(feature = "std")]
mod client;
mod data_type;
mod dictionary;
#[cfg(feature = "std")]
mod emergencies;
pub mod emergency;
pub mod error;
mod error_texts;
#[cfg(feature = "std")]
mod handle;
pub mod information;
#[cfg(feature = "std")]
mod mail_signal;
pub mod mailbox;
pub mod obj;
pub mod object;
pub mod sdo;
#[cfg(all(test, feature = "std"))]
pub(crate) mod test_device;
#[cfg(feature = "std")]
mod transport;
pub mod value;

pub use abort::AbortCode;
#[cfg(feature = "std")]
pub(crate) use client::MailNote;
#[cfg(feature = "std")]
pub use client::{Clock, MailboxClient, MailboxSettings};
pub use data_type::{TypeCode, ValueError};
pub use dictionary::{DictionaryObject, ObjectDictionary, Undescribed};
#[cfg(feature = "std")]
pub(crate) use emergencies::EmergencyQueue;
#[cfg(feature = "std")]
pub use emergencies::{DriveEmergency, Emergencies, EmergencyReport};
pub use emergency::Emergency;
pub use error::{DriveError, DriveId, SdoError, SdoStep, Transfer, TransferKind, Unsupported};
pub use error_texts::{DriveNumber, ErrorTexts};
#[cfg(feature = "std")]
pub use handle::SdoHandle;
#[cfg(feature = "std")]
pub(crate) use mail_signal::MailSignal;
pub use mailbox::MailboxError;
pub use object::{AnyObject, AxisOffset, Mappable, NoAddress, Object, ObjectAddress, Unit};
#[cfg(feature = "std")]
pub use transport::{EthercrabMailbox, LinkFault, MailboxStatus, MailboxTransport};
pub use value::{
    Access, DataType, Number, ReadOnly, ReadWrite, Readable, Value, Writable, WriteOnly,
};
