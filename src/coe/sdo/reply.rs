//! The fields and rules that all replies of an SDO server share.

use super::{SDO_LENGTH, SdoFault, Step};
use crate::coe::abort::AbortCode;
use crate::coe::mailbox::CutMail;
use crate::coe::object::ObjectAddress;

/// Command specifiers of replies: bits 5 to 7 of the first byte.
pub(super) const UPLOAD_SEGMENT: u8 = 0;
pub(super) const DOWNLOAD_SEGMENT: u8 = 1;
pub(super) const UPLOAD: u8 = 2;
pub(super) const DOWNLOAD: u8 = 3;
pub(super) const ABORT: u8 = 4;

/// The fields that all replies share.
pub(super) struct Reply<'a> {
    pub(super) command: u8,
    object: ObjectAddress,
    pub(super) data: [u8; 4],
    pub(super) rest: &'a [u8],
}

impl<'a> Reply<'a> {
    pub(super) fn parse(reply: &'a [u8]) -> Result<Self, CutMail> {
        match *reply {
            [command, i0, i1, subindex, d0, d1, d2, d3, ref rest @ ..] => Ok(Self {
                command,
                object: ObjectAddress::new(u16::from_le_bytes([i0, i1]), subindex),
                data: [d0, d1, d2, d3],
                rest,
            }),
            _ => Err(CutMail {
                needed: SDO_LENGTH,
                got: reply.len(),
            }),
        }
    }

    pub(super) fn specifier(&self) -> u8 {
        self.command >> 5
    }

    pub(super) fn names(&self, object: ObjectAddress) -> bool {
        self.object == object
    }

    /// What every phase does alike: aborts, which name their object, and commands that answer nothing.
    pub(super) fn common(&self, object: ObjectAddress) -> Result<Option<Step>, SdoFault> {
        match self.specifier() {
            ABORT if self.names(object) => {
                Err(SdoFault::Aborted(AbortCode(u32::from_le_bytes(self.data))))
            }
            ABORT => Ok(Some(Step::Foreign)),
            UPLOAD_SEGMENT..=DOWNLOAD => Ok(None),
            _ => Err(SdoFault::Unexpected {
                expected: "an SDO reply",
                got: self.command,
            }),
        }
    }

    pub(super) fn check_toggle(&self, expected: bool) -> Result<(), SdoFault> {
        let got = self.command >> 4 & 1;
        if got == u8::from(expected) {
            return Ok(());
        }
        Err(SdoFault::Toggle {
            expected: u8::from(expected),
            got,
        })
    }

    /// The bytes behind the command, which in a segment are all data.
    pub(super) fn segment_data(&self) -> impl Iterator<Item = u8> + use<'a> {
        let [i0, i1] = self.object.index.to_le_bytes();
        let head = [i0, i1, self.object.subindex];
        let (data, rest) = (self.data, self.rest);
        head.into_iter().chain(data).chain(rest.iter().copied())
    }
}
