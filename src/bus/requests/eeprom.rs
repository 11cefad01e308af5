//! Reading a SubDevice's SII over its registers 0500h to 050Fh (ETG.1000.4, SII interface).

use std::{ops::Range, time::Duration};

use crate::{
    bus::{
        error::{EepromError, RegisterError},
        requests::{LONGEST_DATAGRAM, registers::Registers},
    },
    esc,
    sii::{General, Identity, Sii, text_of_device},
};

/// 0500h: the device has the EEPROM; it is taken from the device by force.
const OWNED_BY_DEVICE: [u8; 1] = [1];
const OWNED_BY_MASTER: [u8; 1] = [0];
const FORCED: [u8; 1] = [2];
/// 0501h bit 0: the device's processor has access.
const DEVICE_HAS_ACCESS: u8 = 0x01;
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
/// First byte of the categories, and the type that ends them.
const CATEGORIES: usize = 0x80;
const END: u16 = 0xFFFF;
/// Bytes of the header with the identity, and with the mailbox and its protocols (words 8h to Fh, 18h to 1Ch).
const HEADER: [Range<usize>; 2] = [0x10..0x20, 0x30..0x3A];
const STRINGS: u16 = 10;
const GENERAL: u16 = 30;
const GENERAL_WORDS: u16 = (General::BYTES / 2) as u16;
const FMMU: u16 = 40;
const SYNC_MANAGERS: u16 = 41;
/// The longest image: the EEPROM is addressed up to 4 Mbit, but no device at hand has more than 64 KiB.
const LONGEST: usize = 0x1_0000;

/// What was read of a SubDevice's SII, byte by byte, so that nothing is read twice.
pub(in crate::bus) type SiiBytes = Vec<Option<u8>>;

/// Reads what configuration needs of a SubDevice's SII: each access takes the EEPROM its time. Other categories are passed over
/// unread, and what is behind the last one that is needed is not looked at. Of the strings it is the type ("order number"), or else
/// the name, which comes beside the rest.
/// The EEPROM must belong to the master (0500h), see [`take_over`].
pub(in crate::bus) async fn read(
    registers: &Registers,
    station: u16,
    bytes: &mut SiiBytes,
) -> Result<(Sii, String), EepromError> {
    let mut image = Image {
        registers,
        station,
        bytes,
    };
    // An image of the same form with nothing but those.
    let mut wanted = image.header(HEADER).await?;
    let mut missing = vec![STRINGS, GENERAL, FMMU, SYNC_MANAGERS];
    let mut strings = None;
    let mut at = CATEGORIES;
    while at < LONGEST && !missing.is_empty() {
        let header = image.get(at..at + 4).await?;
        let &[t0, t1, l0, l1] = header.as_slice() else {
            break;
        };
        let (category, words) = (u16::from_le_bytes([t0, t1]), u16::from_le_bytes([l0, l1]));
        let data = at + 4;
        at = data + 2 * usize::from(words);
        match category {
            END => break,
            STRINGS => strings = Some(data),
            GENERAL => {
                let words = words.min(GENERAL_WORDS);
                wanted.extend([GENERAL, words].into_iter().flat_map(u16::to_le_bytes));
                let end = data + 2 * usize::from(words);
                wanted.extend(image.get(data..end.min(LONGEST)).await?);
            }
            FMMU | SYNC_MANAGERS => {
                wanted.extend(header);
                wanted.extend(image.get(data..at.min(LONGEST)).await?);
            }
            _ => {}
        }
        missing.retain(|missing| *missing != category);
    }
    wanted.extend(END.to_le_bytes());
    let mut sii = Sii::parse(&wanted)?;
    if let Some(mailbox) = &mut sii.mailbox {
        // Devices take a mailbox that is set shorter than their own. No frame with a tag carries a longer one.
        mailbox.receive_length = mailbox.receive_length.min(LONGEST_DATAGRAM);
        mailbox.send_length = mailbox.send_length.min(LONGEST_DATAGRAM);
    }
    let name = match (strings, &sii.general) {
        (Some(strings), Some(general)) if general.order != 0 => {
            image.string(strings, general.order).await?
        }
        (Some(strings), Some(general)) => image.string(strings, general.name).await?,
        _ => String::new(),
    };
    Ok((sii, name))
}

/// Reads who a SubDevice is.
pub(in crate::bus) async fn identity(
    registers: &Registers,
    station: u16,
) -> Result<Identity, EepromError> {
    registers
        .write(station, esc::EEPROM_CONFIGURATION, &OWNED_BY_MASTER)
        .await?;
    take_over(registers, station).await?;
    let mut image = Image {
        registers,
        station,
        bytes: &mut Vec::new(),
    };
    let [identity, _] = HEADER;
    let mut wanted = image.header([identity]).await?;
    wanted.extend(END.to_le_bytes());
    Ok(Sii::parse(&wanted)?.identity)
}

/// Reads what is left of a SubDevice's SII. The EEPROM must belong to the master (0500h).
pub(in crate::bus) async fn read_whole(
    registers: &Registers,
    station: u16,
    bytes: &mut SiiBytes,
) -> Result<Sii, EepromError> {
    let mut image = Image {
        registers,
        station,
        bytes,
    };
    let mut at = CATEGORIES;
    while at < LONGEST {
        let header = image.get(at..at + 4).await?;
        let &[t0, t1, l0, l1] = header.as_slice() else {
            break;
        };
        if u16::from_le_bytes([t0, t1]) == END {
            break;
        }
        at += 4 + 2 * usize::from(u16::from_le_bytes([l0, l1]));
    }
    let whole = image.get(0..(at + 2).min(LONGEST)).await?;
    Ok(Sii::parse(&whole)?)
}

/// Waits until the EEPROM, which 0500h has given to the master, is idle, and takes it by force from a processor that does not let go of
/// it. Whether that was so.
pub(in crate::bus) async fn take_over(
    registers: &Registers,
    station: u16,
) -> Result<bool, EepromError> {
    let time = registers.time();
    let started = time.now();
    loop {
        // Configuration, access and control in one look.
        let [_, access, c0, c1] = registers.read(station, esc::EEPROM_CONFIGURATION).await?;
        const { assert!(esc::EEPROM_CONTROL - esc::EEPROM_CONFIGURATION == 2) };
        let is_over = time.now().saturating_sub(started) >= LIMIT;
        let is_busy = u16::from_le_bytes([c0, c1]) & BUSY != 0;
        if access & DEVICE_HAS_ACCESS != 0 {
            if is_over {
                registers
                    .write(station, esc::EEPROM_CONFIGURATION, &FORCED)
                    .await?;
                registers
                    .write(station, esc::EEPROM_CONFIGURATION, &OWNED_BY_MASTER)
                    .await?;
                settled(registers, station, 0).await?;
                return Ok(true);
            }
        } else if !is_busy {
            return Ok(false);
        } else if is_over {
            // A command that comes while another one is under way, from before, is not taken: what would be read is what that one
            // gives.
            return Err(EepromError::Busy { word: 0 });
        }
        time.sleep(Duration::from_micros(100)).await;
    }
}

/// Gives the EEPROM to the device. Some firmwares need it for PREOP, and those that emulate their EEPROM serve it themselves
/// (ETG.2010, Eeprom/AssignToPdi).
pub(in crate::bus) async fn give_away(
    registers: &Registers,
    station: u16,
) -> Result<(), RegisterError> {
    registers
        .write(station, esc::EEPROM_CONFIGURATION, &OWNED_BY_DEVICE)
        .await
}

/// The image of one SubDevice, as far as it has been read.
struct Image<'a> {
    registers: &'a Registers,
    station: u16,
    bytes: &'a mut SiiBytes,
}

impl Image<'_> {
    /// What is before the categories, of which only these parts are read.
    async fn header(
        &mut self,
        parts: impl IntoIterator<Item = Range<usize>>,
    ) -> Result<Vec<u8>, EepromError> {
        let mut header = vec![0; CATEGORIES];
        for part in parts {
            let bytes = self.get(part.clone()).await?;
            if let Some(place) = header.get_mut(part) {
                place.copy_from_slice(&bytes);
            }
        }
        Ok(header)
    }

    /// Bytes of the image, of which those are read that are not known yet.
    async fn get(&mut self, range: Range<usize>) -> Result<Vec<u8>, EepromError> {
        let mut got = Vec::with_capacity(range.len());
        for at in range {
            if self.known(at).is_none() {
                self.read(at / 2).await?;
            }
            got.push(self.known(at).unwrap_or(0));
        }
        Ok(got)
    }

    fn known(&self, at: usize) -> Option<u8> {
        self.bytes.get(at).copied().flatten()
    }

    /// String `number` of the category whose data begin at `at`; empty where there is none.
    async fn string(&mut self, at: usize, number: u8) -> Result<String, EepromError> {
        if number == 0 || number > self.byte(at).await? {
            return Ok(String::new());
        }
        let mut at = at + 1;
        for _ in 1..number {
            at += 1 + usize::from(self.byte(at).await?);
        }
        let length = usize::from(self.byte(at).await?);
        let text = self.get(at + 1..at + 1 + length).await?;
        Ok(text_of_device(&text))
    }

    async fn byte(&mut self, at: usize) -> Result<u8, EepromError> {
        Ok(self.get(at..at + 1).await?.first().copied().unwrap_or(0))
    }

    /// Reads as many bytes from this word on as the SubDevice gives at once.
    async fn read(&mut self, word: usize) -> Result<(), EepromError> {
        let bytes = read_words(self.registers, self.station, word).await?;
        let from = word * 2;
        let end = from + bytes.len();
        if self.bytes.len() < end {
            self.bytes.resize(end, None);
        }
        for (to, byte) in self.bytes.iter_mut().skip(from).zip(bytes) {
            *to = Some(byte);
        }
        Ok(())
    }
}

async fn read_words(
    registers: &Registers,
    station: u16,
    word: usize,
) -> Result<Vec<u8>, EepromError> {
    let address = u32::try_from(word).unwrap_or(u32::MAX).to_le_bytes();
    let [c0, c1] = READ.to_le_bytes();
    let [a0, a1, a2, a3] = address;
    registers
        .write(station, esc::EEPROM_CONTROL, &[c0, c1, a0, a1, a2, a3])
        .await?;
    let (control, data) = settled(registers, station, word).await?;
    if control & ERRORS != 0 {
        return Err(EepromError::Refused { word, control });
    }
    let length = if control & EIGHT_BYTES != 0 { 8 } else { 4 };
    Ok(data.iter().take(length).copied().collect())
}

/// Control and data, once the EEPROM is not busy any more.
async fn settled(
    registers: &Registers,
    station: u16,
    word: usize,
) -> Result<(u16, [u8; 8]), EepromError> {
    let time = registers.time();
    let started = time.now();
    loop {
        // Control, address and data in one look.
        let [c0, c1, _, _, _, _, data @ ..] =
            registers.read::<14>(station, esc::EEPROM_CONTROL).await?;
        const { assert!(esc::EEPROM_DATA - esc::EEPROM_CONTROL == 6) };
        let control = u16::from_le_bytes([c0, c1]);
        if control & BUSY == 0 {
            return Ok((control, data));
        }
        if time.now().saturating_sub(started) >= LIMIT {
            return Err(EepromError::Busy { word });
        }
        time.sleep(Duration::from_micros(100)).await;
    }
}
