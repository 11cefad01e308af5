//! The SII image of a SubDevice (its EEPROM): identity, mailbox, and the categories that configuration needs
//! (ETG.1000.6, SII; ETG.2010). Unknown categories are skipped.
//!
//! What is read of an image takes at most 32 KiB and 16 times the image: strings, PDOs and FMMUs of no content take their place in a list.

use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;

mod category;
#[cfg(test)]
mod tests;

use category::pdos;
pub use category::{
    ClockMode, CoeDetails, FmmuUsage, General, Mailbox, Pdo, PdoEntry, Protocols, SyncManager,
    SyncManagerUsage,
};

/// Word address of the first category.
const FIRST_CATEGORY: usize = 0x40;

/// What a SubDevice says it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Identity {
    /// The vendor ID, which the ETG assigns.
    pub vendor: u32,
    /// The vendor's product code.
    pub product: u32,
    /// The revision number.
    pub revision: u32,
    /// The serial number; often 0.
    pub serial: u32,
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "vendor {:08X}h, product {:08X}h, revision {:08X}h, serial {:08X}h",
            self.vendor, self.product, self.revision, self.serial
        )
    }
}

/// What an SII image says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sii {
    /// Vendor, product, revision and serial number.
    pub identity: Identity,
    /// The mailbox of the states from PREOP on; `None` if the device has none.
    pub mailbox: Option<Mailbox>,
    /// The strings of category 10; other categories name them by their place, the first being 1.
    pub strings: Vec<String>,
    /// Category 30.
    pub general: Option<General>,
    /// Category 40: what each FMMU is meant for.
    pub fmmu_usage: Vec<FmmuUsage>,
    /// Category 41.
    pub sync_managers: Vec<SyncManager>,
    /// Category 50: what the device sends by default. CoE may say otherwise.
    pub tx_pdos: Vec<Pdo>,
    /// Category 51: what the device receives by default. CoE may say otherwise.
    pub rx_pdos: Vec<Pdo>,
    /// Category 60: modes of the distributed clock.
    pub clock_modes: Vec<ClockMode>,
}

impl Sii {
    /// Reads an image, as it lies in the EEPROM from its first byte on.
    ///
    /// # Errors
    /// [`SiiError`] if the image ends before its header or one of its categories does.
    pub fn parse(image: &[u8]) -> Result<Self, SiiError> {
        let word = |address: usize| Bytes::new(image, address * 2).u16();
        let dword = |address: usize| Bytes::new(image, address * 2).u32();
        let mut sii = Self {
            identity: Identity {
                vendor: dword(0x08)?,
                product: dword(0x0A)?,
                revision: dword(0x0C)?,
                serial: dword(0x0E)?,
            },
            mailbox: Mailbox {
                receive_offset: word(0x18)?,
                receive_length: word(0x19)?,
                send_offset: word(0x1A)?,
                send_length: word(0x1B)?,
                protocols: Protocols(word(0x1C)?),
            }
            .if_any(),
            strings: Vec::new(),
            general: None,
            fmmu_usage: Vec::new(),
            sync_managers: Vec::new(),
            tx_pdos: Vec::new(),
            rx_pdos: Vec::new(),
            clock_modes: Vec::new(),
        };
        let mut bytes = Bytes::new(image, FIRST_CATEGORY * 2);
        loop {
            let category = bytes.u16()?;
            if category == 0xFFFF {
                return Ok(sii);
            }
            let length = usize::from(bytes.u16()?) * 2;
            sii.category(category, bytes.take(length)?)?;
        }
    }

    /// The string with this number, as other categories use it; `None` for 0 or a number that is not there.
    #[must_use]
    pub fn string(&self, number: u8) -> Option<&str> {
        let place = usize::from(number).checked_sub(1)?;
        self.strings.get(place).map(String::as_str)
    }

    /// The device's name: the general category's, if it has one.
    #[must_use]
    pub fn name(&self) -> Option<&str> {
        self.string(self.general.as_ref()?.name)
    }

    fn category(&mut self, category: u16, mut bytes: Bytes<'_>) -> Result<(), SiiError> {
        match category {
            10 => self.strings = strings(&mut bytes)?,
            30 => self.general = Some(General::parse(&mut bytes)?),
            40 => self.fmmu_usage = bytes.rest().iter().copied().map(FmmuUsage::from).collect(),
            41 => {
                // A category is padded to whole words, not to whole entries.
                while bytes.rest().len() >= 8 {
                    self.sync_managers.push(SyncManager::parse(&mut bytes)?);
                }
            }
            50 => pdos(&mut self.tx_pdos, &mut bytes)?,
            51 => pdos(&mut self.rx_pdos, &mut bytes)?,
            60 => {
                while bytes.rest().len() >= 24 {
                    self.clock_modes.push(ClockMode::parse(&mut bytes)?);
                }
            }
            _ => {}
        }
        Ok(())
    }
}

/// An image that ends too early.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("SII image cut: expected {needed} more bytes at {at:04X}h")]
pub struct SiiError {
    /// The byte address.
    pub at: usize,
    /// Bytes needed from there on.
    pub needed: usize,
}

fn strings(bytes: &mut Bytes<'_>) -> Result<Vec<String>, SiiError> {
    let [count] = bytes.array()?;
    let mut strings = Vec::new();
    for _ in 0..count {
        let [length] = bytes.array()?;
        let text = bytes.take(usize::from(length))?;
        strings.push(String::from_utf8_lossy(text.rest()).into_owned());
    }
    Ok(strings)
}

/// Bytes being read from front to back, with the address at which they lie in the image.
struct Bytes<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    fn new(image: &'a [u8], at: usize) -> Self {
        Self {
            bytes: image.get(at..).unwrap_or_default(),
            at,
        }
    }

    fn rest(&self) -> &'a [u8] {
        self.bytes
    }

    fn take(&mut self, length: usize) -> Result<Self, SiiError> {
        let (bytes, rest) = self.bytes.split_at_checked(length).ok_or(SiiError {
            at: self.at,
            needed: length,
        })?;
        let at = self.at;
        (self.bytes, self.at) = (rest, at + length);
        Ok(Self { bytes, at })
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], SiiError> {
        let at = self.at;
        self.take(N)?
            .bytes
            .try_into()
            .map_err(|_| SiiError { at, needed: N })
    }

    fn u16(&mut self) -> Result<u16, SiiError> {
        Ok(u16::from_le_bytes(self.array()?))
    }

    fn u32(&mut self) -> Result<u32, SiiError> {
        Ok(u32::from_le_bytes(self.array()?))
    }
}
