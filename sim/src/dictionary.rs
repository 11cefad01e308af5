//! The part of an object dictionary that is plain storage: fixed values, and a few objects that can be written.

use std::collections::BTreeMap;

use crate::coe::Abort;

/// One stored object.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Stored {
    value: Vec<u8>,
    /// Shortest and longest value that can be written; `None` when it is read-only.
    writable: Option<(usize, usize)>,
}

/// Stored objects by index and subindex.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Dictionary {
    objects: BTreeMap<(u16, u8), Stored>,
}

impl Dictionary {
    /// Adds an object that can only be read.
    pub(crate) fn fixed(&mut self, index: u16, subindex: u8, value: &[u8]) {
        self.objects.insert(
            (index, subindex),
            Stored {
                value: value.to_vec(),
                writable: None,
            },
        );
    }

    /// Adds an object that can be written, with as many bytes as it has.
    pub(crate) fn writable(&mut self, index: u16, subindex: u8, value: &[u8]) {
        let writable = Some((value.len(), value.len()));
        self.objects.insert(
            (index, subindex),
            Stored {
                value: value.to_vec(),
                writable,
            },
        );
    }

    /// Adds an object that can be written with up to `longest` bytes.
    pub(crate) fn text(&mut self, index: u16, subindex: u8, value: &str, longest: usize) {
        let stored = Stored {
            value: value.as_bytes().to_vec(),
            writable: Some((0, longest)),
        };
        self.objects.insert((index, subindex), stored);
    }

    /// Whether there is an object with this index.
    pub(crate) fn owns(&self, index: u16) -> bool {
        self.objects
            .range((index, 0)..=(index, u8::MAX))
            .next()
            .is_some()
    }

    /// The bytes of an object.
    pub(crate) fn upload(&self, index: u16, subindex: u8) -> Result<Vec<u8>, Abort> {
        self.find(index, subindex)
            .map(|stored| stored.value.clone())
    }

    /// The most bytes that can be written to an object.
    pub(crate) fn room(&self, index: u16, subindex: u8) -> Result<usize, Abort> {
        let (_, longest) = self
            .find(index, subindex)?
            .writable
            .ok_or(Abort::ReadOnly)?;
        Ok(longest)
    }

    /// Writes an object.
    pub(crate) fn download(&mut self, index: u16, subindex: u8, data: &[u8]) -> Result<(), Abort> {
        let (shortest, longest) = self
            .find(index, subindex)?
            .writable
            .ok_or(Abort::ReadOnly)?;
        if data.len() > longest {
            return Err(Abort::TooLong);
        }
        if data.len() < shortest {
            return Err(Abort::TooShort);
        }
        if let Some(stored) = self.objects.get_mut(&(index, subindex)) {
            data.clone_into(&mut stored.value);
        }
        Ok(())
    }

    fn find(&self, index: u16, subindex: u8) -> Result<&Stored, Abort> {
        let missing = if self.owns(index) {
            Abort::NoSubindex
        } else {
            Abort::NoObject
        };
        self.objects.get(&(index, subindex)).ok_or(missing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_refusal_has_its_abort_code() {
        let mut dictionary = Dictionary::default();
        dictionary.fixed(0x1000, 0, &[1, 2, 3, 4]);
        dictionary.writable(0x10F1, 1, &[0; 4]);
        dictionary.text(0x5F00, 0, "", 8);
        assert_eq!(
            dictionary.upload(0x1234, 0).unwrap_err().code(),
            0x0602_0000
        );
        assert_eq!(
            dictionary.upload(0x1000, 1).unwrap_err().code(),
            0x0609_0011
        );
        assert_eq!(
            dictionary.download(0x1000, 0, &[0; 4]).unwrap_err().code(),
            0x0601_0002
        );
        assert_eq!(
            dictionary.download(0x10F1, 1, &[0; 5]).unwrap_err().code(),
            0x0607_0012
        );
        assert_eq!(
            dictionary.download(0x10F1, 1, &[0; 2]).unwrap_err().code(),
            0x0607_0013
        );
        assert_eq!(dictionary.download(0x5F00, 0, b"shorter"), Ok(()));
        assert_eq!(dictionary.upload(0x5F00, 0), Ok(b"shorter".to_vec()));
    }
}
