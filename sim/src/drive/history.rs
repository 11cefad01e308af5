//! The errors that a drive remembers: object 1003h (CiA 301), the newest at subindex 1.

use crate::coe::Abort;
use crate::coe::info::{EntryInfo, ObjectCode, ObjectInfo, access, data_type};

/// Errors that are kept; an older one is forgotten.
const CAPACITY: u8 = 8;

/// The error history.
#[derive(Clone, Debug, Default)]
pub(super) struct ErrorHistory {
    codes: Vec<u16>,
}

impl ErrorHistory {
    pub(super) const INDEX: u16 = 0x1003;

    /// Takes an error in; code 0, which says that one is gone, is none.
    pub(super) fn record(&mut self, code: u16) {
        if code != 0 {
            self.codes.insert(0, code);
            self.codes.truncate(usize::from(CAPACITY));
        }
    }

    /// Subindex 0: how many there are; the others: the code, and in the upper half what the maker adds, here nothing.
    pub(super) fn upload(&self, subindex: u8) -> Result<Vec<u8>, Abort> {
        if subindex > CAPACITY {
            return Err(Abort::NoSubindex);
        }
        let Some(at) = usize::from(subindex).checked_sub(1) else {
            return Ok(vec![u8::try_from(self.codes.len()).unwrap_or(CAPACITY)]);
        };
        let code = self.codes.get(at).ok_or(Abort::NoData)?;
        Ok(u32::from(*code).to_le_bytes().to_vec())
    }

    pub(super) fn room(subindex: u8) -> Result<usize, Abort> {
        match subindex {
            0 => Ok(1),
            1..=CAPACITY => Err(Abort::ReadOnly),
            _ => Err(Abort::NoSubindex),
        }
    }

    /// A zero at subindex 0 forgets all errors; nothing else can be written.
    pub(super) fn download(&mut self, subindex: u8, data: &[u8]) -> Result<(), Abort> {
        Self::room(subindex)?;
        match data {
            [] => Err(Abort::TooShort),
            [0] => {
                self.codes.clear();
                Ok(())
            }
            [_] => Err(Abort::Range),
            _ => Err(Abort::TooLong),
        }
    }

    pub(super) fn object() -> ObjectInfo {
        ObjectInfo {
            data_type: data_type::U32,
            last: CAPACITY,
            code: ObjectCode::Array,
            name: "Pre-defined error field".into(),
        }
    }

    pub(super) fn entry(subindex: u8) -> Result<EntryInfo, Abort> {
        match subindex {
            0 => Ok(EntryInfo::new(
                data_type::U8,
                8,
                access::READ | access::WRITE,
                "Number of errors",
            )),
            1..=CAPACITY => Ok(EntryInfo::new(data_type::U32, 32, access::READ, "Error")),
            _ => Err(Abort::NoSubindex),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_error_comes_first_and_the_ninth_pushes_the_oldest_out() {
        let mut history = ErrorHistory::default();
        for code in 0x8601..=0x8609 {
            history.record(code);
            history.record(0);
        }
        assert_eq!(history.upload(0), Ok(vec![8]));
        assert_eq!(history.upload(1), Ok(vec![0x09, 0x86, 0, 0]));
        assert_eq!(history.upload(8), Ok(vec![0x02, 0x86, 0, 0]));
        assert_eq!(history.upload(9), Err(Abort::NoSubindex));
    }

    #[test]
    fn only_a_zero_can_be_written_and_forgets_all() {
        let mut history = ErrorHistory::default();
        history.record(0x7320);
        assert_eq!(history.download(0, &[1]), Err(Abort::Range));
        assert_eq!(history.download(1, &[0; 4]), Err(Abort::ReadOnly));
        assert_eq!(history.download(0, &[0]), Ok(()));
        assert_eq!(history.upload(0), Ok(vec![0]));
        assert_eq!(history.upload(1), Err(Abort::NoData));
    }
}
