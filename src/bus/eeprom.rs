//! Reading a SubDevice's SII image over its registers 0500h to 050Fh (ETG.1000.4, SII interface).

use std::time::Duration;

use super::registers::{RegisterError, Registers};
use crate::sii::{Sii, SiiError};

const CONFIGURATION: u16 = 0x0500;
const CONTROL: u16 = 0x0502;
const DATA: u16 = 0x0508;

const OWNED_BY_MASTER: [u8; 1] = [0];
const OWNED_BY_DEVICE: [u8; 1] = [1];
/// Command of 0502h: read.
const READ: u16 = 0x0100;
/// 0502h bit 6: eight bytes at once, else four.
const EIGHT_BYTES: u16 = 0x0040;
/// 0502h bits 13 and 14: no acknowledge of the EEPROM or a bad command, write refused.
const ERRORS: u16 = 0x6000;
/// 0502h bit 15.
const BUSY: u16 = 0x8000;

/// How long the EEPROM may be busy with one word.
const LIMIT: Duration = Duration::from_millis(50);
/// First word of the categories, and the type that ends them.
const CATEGORIES: usize = 0x40;
const END: [u8; 2] = [0xFF, 0xFF];
/// The longest image: the EEPROM is addressed up to 4 Mbit, but no device at hand has more than 64 KiB.
const LONGEST: usize = 0x1_0000;

/// Why the SII could not be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum EepromError {
    /// The registers could not be reached.
    #[error(transparent)]
    Register(#[from] RegisterError),
    /// The SubDevice reports an error.
    #[error("the SII interface reports an error at word {word:04X}h (0502h is {control:04X}h)")]
    Refused {
        /// The word asked for.
        word: usize,
        /// Register 0502h.
        control: u16,
    },
    /// The EEPROM stayed busy.
    #[error("the SII interface stayed busy at word {word:04X}h")]
    Busy {
        /// The word asked for.
        word: usize,
    },
    /// What was read is no SII image.
    #[error(transparent)]
    Image(#[from] SiiError),
}

/// Reads and parses the SII image up to its end mark.
pub(super) async fn read(registers: &Registers, station: u16) -> Result<Sii, EepromError> {
    registers
        .write(station, CONFIGURATION, &OWNED_BY_MASTER)
        .await?;
    let mut image = Vec::new();
    // Each category says where the next one begins; the image is complete with the end mark.
    let mut category = CATEGORIES * 2;
    while image.len() < LONGEST {
        read_words(registers, station, &mut image).await?;
        while let Some(&[t0, t1, l0, l1]) = image.get(category..category + 4) {
            if [t0, t1] == END {
                return Ok(Sii::parse(&image)?);
            }
            category += 4 + 2 * usize::from(u16::from_le_bytes([l0, l1]));
        }
        if image
            .get(category..)
            .is_some_and(|rest| rest.starts_with(&END))
        {
            return Ok(Sii::parse(&image)?);
        }
    }
    Ok(Sii::parse(&image)?)
}

/// Gives the EEPROM to the device, as some firmwares need it for SAFEOP (ETG.2010, Eeprom/AssignToPdi).
pub(super) async fn give_away(registers: &Registers, station: u16) -> Result<(), RegisterError> {
    registers
        .write(station, CONFIGURATION, &OWNED_BY_DEVICE)
        .await
}

async fn read_words(
    registers: &Registers,
    station: u16,
    image: &mut Vec<u8>,
) -> Result<(), EepromError> {
    let word = image.len() / 2;
    let address = u32::try_from(word).unwrap_or(u32::MAX).to_le_bytes();
    let [c0, c1] = READ.to_le_bytes();
    let [a0, a1, a2, a3] = address;
    registers
        .write(station, CONTROL, &[c0, c1, a0, a1, a2, a3])
        .await?;
    let time = registers.time();
    let started = time.now();
    loop {
        // Control, address and data in one look.
        let [c0, c1, _, _, _, _, data @ ..] = registers.read::<14>(station, CONTROL).await?;
        const { assert!(DATA - CONTROL == 6) };
        let control = u16::from_le_bytes([c0, c1]);
        if control & BUSY == 0 {
            if control & ERRORS != 0 {
                return Err(EepromError::Refused { word, control });
            }
            let length = if control & EIGHT_BYTES != 0 { 8 } else { 4 };
            image.extend(data.iter().take(length));
            return Ok(());
        }
        if time.now().saturating_sub(started) >= LIMIT {
            return Err(EepromError::Busy { word });
        }
        time.sleep(Duration::from_micros(100)).await;
    }
}
