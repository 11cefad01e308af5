//! CANopen over EtherCAT: typed objects, the SDO codec, the mailbox client, emergencies.
//!
//! Pure: objects and values, and [`obj`] (the known objects); [`mailbox`], [`sdo`], [`information`] and [`Emergency`] (bytes and
//! transfers without I/O), errors. With `std`: the mailbox client, one per device, and its transport.

#[cfg(feature = "std")]
mod client;
#[cfg(feature = "std")]
mod emergencies;
mod emergency;
mod error;
#[cfg(feature = "std")]
mod handle;
#[cfg(feature = "std")]
mod history;
pub mod information;
pub mod mailbox;
pub mod obj;
mod object;
pub mod sdo;
#[cfg(all(test, feature = "std"))]
pub(crate) mod test_device;
#[cfg(feature = "std")]
mod transport;
pub(crate) mod value;

#[cfg(feature = "std")]
pub use client::{Clock, MailboxClient, MailboxSettings};
#[cfg(feature = "std")]
pub(crate) use client::{MailboxRecord, MailboxSignal, UnservedMailbox};
#[cfg(feature = "std")]
pub(crate) use emergencies::{CodeCounts, EmergencyQueue};
#[cfg(feature = "std")]
pub use emergencies::{DriveEmergency, Emergencies, EmergencyReport};
pub use emergency::Emergency;
pub use error::AbortCode;
pub use error::{
    DriveError, DriveId, DriveNumber, ErrorTexts, NoInformation, SdoError, SdoStep, Transfer,
    TransferKind,
};
#[cfg(feature = "std")]
pub use handle::{RemoteRequest, RemoteTransfer, RemoteTransfers, SdoHandle};
#[cfg(feature = "std")]
pub use history::{
    DiagnosisHistory, DiagnosisMessage, DiagnosisParameter, DriveHistory, HistoryFault,
    HistoryRecord, RecordedError, Severity,
};
pub use object::{AnyObject, AxisOffset, Mappable, NoAddress, Object, ObjectAddress, ObjectUnit};
#[cfg(feature = "std")]
pub use transport::{EthercrabMailbox, LinkFault, LinkRefusal, MailboxStatus, MailboxTransport};
pub use value::{
    Access, DataType, Number, ReadOnly, ReadWrite, Readable, TypeCode, Value, ValueError, Writable,
    WriteOnly,
};
