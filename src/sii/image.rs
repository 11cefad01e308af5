//! A whole image that may be written to an EEPROM.

use alloc::vec::Vec;

use super::{Identity, Sii, SiiError};

/// The word whose low byte is the checksum of all words before it.
const CHECKSUM_WORD: usize = 7;
/// The word of the configured station alias.
const ALIAS_WORD: usize = 4;
/// The word of the EEPROM's size in kbit, less one.
const SIZE_WORD: usize = 0x3E;
/// An image whose checksum is right and whose categories are whole: what may be written to an EEPROM. A file of it has the bytes as they lie
/// there, from the first one on, as SOEM's `eepromtool -r` writes them.
///
/// ```no_run
/// use servocrab::sii::SiiImage;
/// let image = SiiImage::new(std::fs::read("drive.bin")?)?;
/// assert_eq!(image.with_alias(7).alias(), 7);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SiiImage {
    bytes: Vec<u8>,
    identity: Identity,
}

impl SiiImage {
    /// The longest image in bytes: the EEPROM is addressed up to 4 Mbit, but no device at hand has more than 64 KiB.
    pub const LONGEST: usize = 0x1_0000;

    /// The image of these bytes.
    ///
    /// # Errors
    /// [`SiiImageError`] if they end within the header or a category, are not of whole words, are more than they say of themselves, or
    /// have another checksum.
    pub fn new(bytes: impl Into<Vec<u8>>) -> Result<Self, SiiImageError> {
        let bytes = bytes.into();
        let most = Self::room(&bytes).unwrap_or(Self::LONGEST);
        if bytes.len() % 2 != 0 || bytes.len() > most {
            let got = bytes.len();
            return Err(SiiImageError::Length { most, got });
        }
        let identity = Sii::parse(&bytes)?.identity;
        let (expected, got) = (
            checksum(&bytes),
            word(&bytes, CHECKSUM_WORD).to_le_bytes()[0],
        );
        if expected != got {
            return Err(SiiImageError::Checksum { expected, got });
        }
        Ok(Self { bytes, identity })
    }

    /// How many bytes an EEPROM has by its word 3Eh, valid or not; none if that says nothing, or more than [`LONGEST`](Self::LONGEST).
    #[must_use]
    pub fn room(bytes: &[u8]) -> Option<usize> {
        let kbit = usize::from(word(bytes, SIZE_WORD));
        Some((kbit + 1) * 128).filter(|bytes| kbit != 0 && *bytes <= Self::LONGEST)
    }

    /// The bytes, from the first one of the EEPROM on.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Which device it is for (words 8h to Fh).
    #[must_use]
    pub const fn identity(&self) -> Identity {
        self.identity
    }

    /// The configured station alias (word 4); 0 if none.
    #[must_use]
    pub fn alias(&self) -> u16 {
        word(&self.bytes, ALIAS_WORD)
    }

    /// The same with another alias and its checksum.
    #[must_use]
    pub fn with_alias(mut self, alias: u16) -> Self {
        put(&mut self.bytes, ALIAS_WORD, alias);
        let checksum = checksum(&self.bytes);
        put(&mut self.bytes, CHECKSUM_WORD, checksum.into());
        self
    }

    /// The words to be written, in this order, where an EEPROM holds `before`: address and value of those that differ; none if none does.
    /// A wrong checksum comes first and the right one last. So no device takes a part of an image for the whole when its power goes
    /// between them.
    #[must_use]
    pub fn writes_over(&self, before: &[u8]) -> Vec<(usize, u16)> {
        let words = self.bytes.chunks_exact(2).enumerate();
        let differing: Vec<_> = words
            .filter(|(at, bytes)| before.get(2 * at..2 * at + 2) != Some(*bytes))
            .map(|(at, _)| (at, word(&self.bytes, at)))
            .collect();
        if differing.is_empty() {
            return differing;
        }
        let checksum = |value| (CHECKSUM_WORD, value);
        let first = checksum(self.wrong_checksum(before).into());
        let others = differing.into_iter().filter(|(at, _)| *at != CHECKSUM_WORD);
        let last = checksum(word(&self.bytes, CHECKSUM_WORD));
        [first].into_iter().chain(others).chain([last]).collect()
    }

    /// One that is wrong for the words before, for the image, and for all in between: each word may be old, erased or new.
    fn wrong_checksum(&self, before: &[u8]) -> u8 {
        let mut words = [0xFF; 2 * CHECKSUM_WORD];
        words
            .iter_mut()
            .zip(before)
            .for_each(|(word, old)| *word = *old);
        let mut right = Vec::from([checksum(&words)]);
        for at in 0..CHECKSUM_WORD {
            for value in [0xFFFF, word(&self.bytes, at)] {
                put(&mut words, at, value);
                right.push(checksum(&words));
            }
        }
        (0..=0xFF).find(|wrong| !right.contains(wrong)).unwrap_or(0)
    }
}

/// Why bytes are no image that may be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SiiImageError {
    /// They end within the header or a category.
    #[error(transparent)]
    Cut(#[from] SiiError),
    /// They are not of whole words, or more than the EEPROM has by their own word 3Eh.
    #[error("an SII image of {got} bytes: expected whole words, and at most {most} bytes")]
    Length {
        /// The most.
        most: usize,
        /// Their number.
        got: usize,
    },
    /// The low byte of word 7 is not the checksum of words 0 to 6.
    #[error("the checksum of the SII image is {got:02X}h, and {expected:02X}h by its words 0 to 6")]
    Checksum {
        /// As calculated.
        expected: u8,
        /// As in word 7.
        got: u8,
    },
}

/// The checksum of the first seven words: CRC with x^8 + x^2 + x + 1 and the initial value FFh (ETG.1000.6, ESC configuration area).
fn checksum(image: &[u8]) -> u8 {
    let words = image.iter().take(2 * CHECKSUM_WORD);
    words.fold(0xFF, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc, _| {
            crc << 1 ^ if crc & 0x80 != 0 { 0x07 } else { 0 }
        })
    })
}

/// A word of an image; 0 behind its end.
fn word(image: &[u8], word: usize) -> u16 {
    match image.get(2 * word..2 * word + 2) {
        Some(&[low, high]) => u16::from_le_bytes([low, high]),
        _ => 0,
    }
}

fn put(image: &mut [u8], word: usize, value: u16) {
    if let Some(place) = image.get_mut(2 * word..2 * word + 2) {
        place.copy_from_slice(&value.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec;

    /// Words 0 to 7 are those of a real AKD (the public ethercrab repository, dumps/eeprom/akd.hex).
    fn image() -> Vec<u8> {
        let mut image = vec![0; 0x80];
        image[..16].copy_from_slice(&[9, 0, 0, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x10, 0]);
        image[0x10] = 0x6A;
        image.extend([0xFF, 0xFF]);
        image
    }

    #[test]
    fn the_checksum_of_a_real_akd_is_right_and_follows_the_alias() {
        let image = SiiImage::new(image()).unwrap();
        assert_eq!((image.identity().vendor, image.alias()), (0x6A, 0));
        let other = image.with_alias(7);
        assert_eq!(other.alias(), 7);
        assert_eq!(SiiImage::new(other.bytes()), Ok(other));
    }

    #[test]
    fn what_is_no_whole_image_with_its_checksum_is_refused() {
        let (expected, got) = (0x10, 0x11);
        let mut wrong = image();
        wrong[14] = got;
        let error = SiiImage::new(wrong).unwrap_err();
        assert_eq!(error, SiiImageError::Checksum { expected, got });
        let cut = SiiImage::new(&image()[..0x80]).unwrap_err();
        assert!(matches!(cut, SiiImageError::Cut(_)));
        let mut longer = image();
        longer[0x7C] = 1;
        longer.resize(258, 0xFF);
        let (most, got) = (256, 258);
        let error = SiiImage::new(longer).unwrap_err();
        assert_eq!(error, SiiImageError::Length { most, got });
    }
}
