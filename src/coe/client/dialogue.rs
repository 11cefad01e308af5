//! A transfer as the client sees it: of either direction, with the reasons for which it fails.

use alloc::string::ToString;
use alloc::vec::Vec;
use core::time::Duration;

use crate::coe::abort::AbortCode;
use crate::coe::error::{SdoError, SdoStep, Transfer};
use crate::coe::handle::Request;
use crate::coe::mailbox::MailboxError;
use crate::coe::object::ObjectAddress;
use crate::coe::sdo::{Download, SdoFault, Step, Upload};
use crate::coe::transport::LinkFault;

/// A transfer of either direction.
pub(super) enum Dialogue {
    Upload(Upload),
    Download(Download),
}

impl Dialogue {
    pub(super) fn of(request: Request, write_length: usize) -> Self {
        let object: ObjectAddress = request.transfer.object;
        if request.is_read() {
            let mut upload = Upload::new(object);
            if let Some(width) = request.width {
                upload = upload.width(width);
            }
            if request.complete_access {
                upload = upload.complete_access();
            }
            return Self::Upload(upload);
        }
        let mut download = Download::new(object, request.data, write_length);
        if request.complete_access {
            download = download.complete_access();
        }
        Self::Download(download)
    }

    pub(super) fn request(&self) -> Vec<u8> {
        match self {
            Self::Upload(upload) => upload.request().to_vec(),
            Self::Download(download) => download.request(),
        }
    }

    pub(super) fn feed(&mut self, reply: &[u8]) -> Result<Step, SdoFault> {
        match self {
            Self::Upload(upload) => upload.feed(reply),
            Self::Download(download) => download.feed(reply),
        }
    }

    pub(super) const fn is_segmented(&self) -> bool {
        match self {
            Self::Upload(upload) => upload.is_segmented(),
            Self::Download(download) => download.is_segmented(),
        }
    }

    pub(super) fn into_data(self) -> Vec<u8> {
        match self {
            Self::Upload(upload) => upload.into_data(),
            Self::Download(_) => Vec::new(),
        }
    }
}

/// Why an exchange failed, before it is told with its object.
#[derive(Debug, Clone, Copy)]
pub(super) enum Failure {
    Fault(SdoFault),
    Refused(MailboxError),
    NotTaken,
    NoReply,
    Link(LinkFault),
}

impl Failure {
    pub(super) fn describe(self, transfer: Transfer, after: Duration, segmented: bool) -> SdoError {
        let reply = if segmented {
            SdoStep::Segment
        } else {
            SdoStep::Reply
        };
        let timeout = |step| SdoError::Timeout {
            transfer,
            step,
            after,
        };
        match self {
            Self::Fault(fault) => SdoError::from_fault(transfer, fault),
            Self::Refused(error) => SdoError::Mailbox { transfer, error },
            Self::NotTaken => timeout(SdoStep::Sending),
            Self::NoReply => timeout(reply),
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
            Self::Refused(_) | Self::Link(_) => None,
        }
    }
}
