//! A transfer as the client sees it: of either direction, with the reasons for which it fails.

use alloc::string::ToString;
use alloc::vec::Vec;
use core::time::Duration;

use crate::coe::abort::AbortCode;
use crate::coe::error::{SdoError, SdoStep, Transfer, Unsupported};
use crate::coe::information::{Inquiry, Question};
use crate::coe::mailbox::{Counter, Mail, MailboxError, information_mail, sdo_mail};
use crate::coe::sdo::{Download, SdoFault, Step, Upload};
use crate::coe::transport::LinkFault;

/// A transfer of either direction, or a question.
#[derive(Debug)]
pub(in crate::coe) enum Dialogue {
    Upload(Upload),
    Download(Download),
    Inquiry(Inquiry, Question),
}

impl Dialogue {
    /// Makes of `mail` the one that is due.
    pub(super) fn compose(&self, mail: &mut Vec<u8>, counter: Counter) {
        match self {
            Self::Upload(upload) => sdo_mail(mail, counter, |mail| {
                mail.extend_from_slice(&upload.request());
            }),
            Self::Download(download) => {
                sdo_mail(mail, counter, |mail| download.append_request(mail));
            }
            Self::Inquiry(inquiry, _) => {
                information_mail(mail, counter, |mail| inquiry.append_request(mail));
            }
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
                return Err(Failure::NoService(Unsupported::Service(code)));
            }
            _ => Ok(Step::Foreign),
        };
        step.map_err(Failure::Fault)
    }

    /// Whether the device writes the object when it takes the message that is due. Not where segments follow: their toggle bit
    /// shows one that comes twice.
    pub(super) fn writes_at_once(&self) -> bool {
        match self {
            Self::Download(download) => !download.is_segmented() && download.fits_one_mail(),
            Self::Upload(_) | Self::Inquiry(..) => false,
        }
    }

    pub(super) const fn is_question(&self) -> bool {
        matches!(self, Self::Inquiry(..))
    }

    pub(super) const fn is_segmented(&self) -> bool {
        match self {
            Self::Upload(upload) => upload.is_segmented(),
            Self::Download(download) => download.is_segmented(),
            Self::Inquiry(..) => false,
        }
    }

    /// What a reply would be now.
    pub(in crate::coe) fn waits_for(&self) -> SdoStep {
        match self {
            Self::Inquiry(inquiry, _) if inquiry.is_under_way() => SdoStep::Fragment,
            _ if self.is_segmented() => SdoStep::Segment,
            _ => SdoStep::Reply,
        }
    }

    /// Bytes that the answer has had.
    pub(in crate::coe) const fn room_taken(&self) -> usize {
        match self {
            Self::Upload(upload) => upload.received(),
            Self::Download(_) => 0,
            Self::Inquiry(inquiry, _) => inquiry.received(),
        }
    }

    pub(in crate::coe) fn into_data(self) -> Vec<u8> {
        match self {
            Self::Upload(upload) => upload.into_data(),
            Self::Download(_) => Vec::new(),
            Self::Inquiry(inquiry, _) => inquiry.into_data(),
        }
    }

    /// Distinguishes the refusal of a question from a device without the service.
    pub(in crate::coe) fn judge(&self, error: SdoError) -> SdoError {
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

/// Why an exchange failed, before it is reported with its object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::coe) enum Failure {
    Fault(SdoFault),
    Refused(MailboxError),
    /// The device has no SDO information.
    NoService(Unsupported),
    NotTaken,
    NoReply,
    /// The late reply of an earlier transfer has not come, nor any other.
    EarlierReply,
    /// The frame with the message is lost, and the device must not get it twice.
    Doubtful,
    Link(LinkFault),
}

impl Failure {
    /// The error, where it may allocate: on the caller's thread.
    pub(in crate::coe) fn describe(
        self,
        transfer: Transfer,
        after: Duration,
        reply: SdoStep,
    ) -> SdoError {
        let timeout = |step| SdoError::Timeout {
            transfer,
            step,
            after,
        };
        match self {
            Self::Fault(fault) => SdoError::from_fault(transfer, fault),
            Self::Refused(error) => SdoError::Mailbox { transfer, error },
            Self::NoService(reason) => SdoError::NotSupported { transfer, reason },
            Self::EarlierReply => timeout(SdoStep::EarlierReply),
            Self::NotTaken => timeout(SdoStep::Sending),
            Self::NoReply | Self::Doubtful => timeout(reply),
            Self::Link(fault) => SdoError::Link {
                transfer,
                step: reply,
                reason: fault.to_string(),
            },
        }
    }

    /// The abort code for the device, if it has to get one.
    pub(super) const fn abort_code(&self) -> Option<AbortCode> {
        match self {
            Self::Fault(fault) => fault.abort_code(),
            Self::NotTaken | Self::NoReply => Some(AbortCode::TIME_OUT),
            Self::Refused(_)
            | Self::NoService(_)
            | Self::EarlierReply
            | Self::Doubtful
            | Self::Link(_) => None,
        }
    }
}
