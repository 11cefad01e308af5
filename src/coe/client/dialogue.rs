//! A transfer as the client sees it: of either direction, with the reasons for which it fails.

use alloc::string::ToString;
use alloc::vec::Vec;
use core::time::Duration;

use crate::coe::abort::AbortCode;
use crate::coe::error::{SdoError, SdoStep, Transfer, Unsupported};
use crate::coe::handle::{Body, Request};
use crate::coe::information::{Inquiry, Question};
use crate::coe::mailbox::{Counter, Mail, MailboxError, information_mail, sdo_mail};
use crate::coe::object::ObjectAddress;
use crate::coe::sdo::{Download, SdoFault, Step, Upload};
use crate::coe::transport::LinkFault;

/// A transfer of either direction, or a question.
pub(super) enum Dialogue {
    Upload(Upload),
    Download(Download),
    Inquiry(Inquiry, Question),
}

impl Dialogue {
    pub(super) fn of(request: Request, write_length: usize) -> Self {
        let object: ObjectAddress = request.transfer.object;
        match request.body {
            Body::Upload {
                complete_access,
                width,
            } => {
                let mut upload = Upload::new(object);
                if let Some(width) = width {
                    upload = upload.width(width);
                }
                if complete_access {
                    upload = upload.complete_access();
                }
                Self::Upload(upload)
            }
            Body::Download {
                complete_access,
                data,
            } => {
                let download = Download::new(object, data, write_length);
                Self::Download(if complete_access {
                    download.complete_access()
                } else {
                    download
                })
            }
            Body::Ask(question) => Self::Inquiry(Inquiry::new(question), question),
        }
    }

    /// The mail that is due.
    pub(super) fn mail(&self, counter: Counter) -> Vec<u8> {
        match self {
            Self::Upload(upload) => sdo_mail(counter, &upload.request()),
            Self::Download(download) => sdo_mail(counter, &download.request()),
            Self::Inquiry(inquiry, _) => information_mail(counter, &inquiry.request()),
        }
    }

    /// Takes a reply. `nothing_late` if no reply of an earlier request can come any more.
    pub(super) fn feed(&mut self, reply: Mail<'_>, nothing_late: bool) -> Result<Step, Failure> {
        let step = match (self, reply) {
            (Self::Upload(upload), Mail::SdoReply(reply)) => upload.feed(reply),
            (Self::Download(download), Mail::SdoReply(reply)) => download.feed(reply),
            (Self::Inquiry(inquiry, _), Mail::SdoInformation(reply)) => inquiry.feed(reply),
            // A device without the service may say so by an SDO abort.
            (Self::Inquiry(..), Mail::SdoReply(&[0x80, _, _, _, c0, c1, c2, c3, ..]))
                if nothing_late =>
            {
                let code = AbortCode(u32::from_le_bytes([c0, c1, c2, c3]));
                return Err(Failure::NoService(code));
            }
            _ => Ok(Step::Foreign),
        };
        step.map_err(Failure::Fault)
    }

    /// Whether the device writes the object when it takes the mail that is due: not where segments follow, whose toggle bit
    /// tells it one that comes twice.
    pub(super) fn writes_at_once(&self) -> bool {
        match self {
            Self::Download(download) => !download.is_segmented() && download.fits_one_mail(),
            Self::Upload(_) | Self::Inquiry(..) => false,
        }
    }

    pub(super) const fn is_segmented(&self) -> bool {
        match self {
            Self::Upload(upload) => upload.is_segmented(),
            Self::Download(download) => download.is_segmented(),
            Self::Inquiry(..) => false,
        }
    }

    /// What a reply would be now.
    pub(super) fn waits_for(&self) -> SdoStep {
        match self {
            Self::Inquiry(inquiry, _) if inquiry.is_under_way() => SdoStep::Fragment,
            _ if self.is_segmented() => SdoStep::Segment,
            _ => SdoStep::Reply,
        }
    }

    pub(super) fn into_data(self) -> Vec<u8> {
        match self {
            Self::Upload(upload) => upload.into_data(),
            Self::Download(_) => Vec::new(),
            Self::Inquiry(inquiry, _) => inquiry.into_data(),
        }
    }

    /// Tells the refusal of a question from a device without the service.
    pub(super) fn judge(&self, error: SdoError) -> SdoError {
        let Self::Inquiry(_, question) = self else {
            return error;
        };
        let is_about_all = matches!(question, Question::Counts | Question::List(_));
        let reason = match &error {
            SdoError::Mailbox { error, .. } if error.is_about_the_service() => {
                Unsupported::Mail(*error)
            }
            SdoError::Aborted { code, .. }
                if is_about_all
                    && matches!(*code, AbortCode::COMMAND | AbortCode::UNSUPPORTED_ACCESS) =>
            {
                Unsupported::Service(*code)
            }
            _ => return error,
        };
        SdoError::NotSupported {
            transfer: error.transfer(),
            reason,
        }
    }
}

/// Why an exchange failed, before it is told with its object.
#[derive(Debug, Clone, Copy)]
pub(super) enum Failure {
    Fault(SdoFault),
    Refused(MailboxError),
    /// The device refuses SDO information as such.
    NoService(AbortCode),
    NotTaken,
    NoReply,
    /// The frame with the mail is lost, and the device must not get it twice.
    Doubtful,
    Link(LinkFault),
}

impl Failure {
    pub(super) fn describe(self, transfer: Transfer, after: Duration, reply: SdoStep) -> SdoError {
        let timeout = |step| SdoError::Timeout {
            transfer,
            step,
            after,
        };
        match self {
            Self::Fault(fault) => SdoError::from_fault(transfer, fault),
            Self::Refused(error) => SdoError::Mailbox { transfer, error },
            Self::NoService(code) => SdoError::NotSupported {
                transfer,
                reason: Unsupported::Service(code),
            },
            Self::NotTaken => timeout(SdoStep::Sending),
            Self::NoReply | Self::Doubtful => timeout(reply),
            Self::Link(fault) => SdoError::Link {
                transfer,
                step: reply,
                reason: fault.to_string(),
            },
        }
    }

    /// What to tell the device, if it has to be told.
    pub(super) const fn abort_code(&self) -> Option<AbortCode> {
        match self {
            Self::Fault(fault) => fault.abort_code(),
            Self::NotTaken | Self::NoReply => Some(AbortCode::TIME_OUT),
            Self::Refused(_) | Self::NoService(_) | Self::Doubtful | Self::Link(_) => None,
        }
    }
}
