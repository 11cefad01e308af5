//! Reading and writing a SubDevice's SII over its registers 0500h to 050Fh (ETG.1000.4, SII interface).

use std::{ops::Range, time::Duration};

use crate::{
    bus::{
        error::{EepromError, RegisterError},
        requests::{LONGEST_DATAGRAM, registers::Registers},
    },
    esc,
    sii::{General, Identity, Sii, SiiImage, text_of_device},
};

/// 0500h: the device has the EEPROM; it is taken from the device by force.
const OWNED_BY_DEVICE: [u8; 1] = [1];
const OWNED_BY_MASTER: [u8; 1] = [0];
const FORCED: [u8; 1] = [2];
/// 0501h bit 0: the device's processor has access.
const DEVICE_HAS_ACCESS: u8 = 0x01;
/// Command of 0502h: read.
const READ: u16 = 0x0100;
/// The same: write with write enable, and load words 0 to 7 again.
const WRITE: u16 = 0x0201;
const RELOAD: u16 = 0x0400;
/// 0502h bit 5: the device's processor serves the EEPROM.
const EMULATED: u16 = 0x0020;
/// 0502h bit 6: eight bytes at once, else four.
const EIGHT_BYTES: u16 = 0x0040;
/// 0502h bits 11 and 12: the checksum is wrong, words 0 to 7 are not loaded.
const NOT_LOADED: u16 = 0x1800;
/// 0502h bit 13: no acknowledge, since the EEPROM is at work on a word, or a bad command.
const NO_ACKNOWLEDGE: u16 = 0x2000;
/// 0502h bits 13 and 14: no acknowledge of the EEPROM or a bad command, write refused.
const ERRORS: u16 = 0x6000;
/// 0502h bit 15.
const BUSY: u16 = 0x8000;

/// How long the EEPROM may be busy with one word.
const LIMIT: Duration = Duration::from_millis(50);
/// The same for a processor, which may write a word to flash memory. Assumed: sectors of these take up to 2 s to be erased.
const EMULATION_LIMIT: Duration = Duration::from_secs(3);
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
const LONGEST: usize = SiiImage::LONGEST;

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
    let end = image.end_of_categories().await?;
    let whole = image.get(0..end).await?;
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
                settled(registers, station, 0, LIMIT).await?;
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

    /// The first byte behind the mark that ends the categories.
    async fn end_of_categories(&mut self) -> Result<usize, EepromError> {
        let mut at = CATEGORIES;
        while at < LONGEST {
            let header = self.get(at..at + 4).await?;
            let &[t0, t1, l0, l1] = header.as_slice() else {
                break;
            };
            if u16::from_le_bytes([t0, t1]) == END {
                break;
            }
            at += 4 + 2 * usize::from(u16::from_le_bytes([l0, l1]));
        }
        Ok((at + 2).min(LONGEST))
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

/// The EEPROM of one SubDevice, of which all is read and written.
pub(in crate::bus) struct WholeEeprom<'a> {
    registers: &'a Registers,
    pub station: u16,
    /// How long it may take for one word that is written.
    limit: Duration,
}

impl<'a> WholeEeprom<'a> {
    /// That of the SubDevice at this place in the line, which has its station address.
    pub async fn at(registers: &'a Registers, position: u16) -> Result<Self, EepromError> {
        let station = registers.read_at(position, esc::STATION_ADDRESS).await?;
        Self::of(registers, u16::from_le_bytes(station)).await
    }

    /// That of the SubDevice with this station address.
    pub async fn of(registers: &'a Registers, station: u16) -> Result<Self, EepromError> {
        let control = registers.read(station, esc::EEPROM_CONTROL).await?;
        let limit = match u16::from_le_bytes(control) & EMULATED {
            0 => LIMIT,
            _ => EMULATION_LIMIT,
        };
        Ok(Self {
            registers,
            station,
            limit,
        })
    }

    /// Reads all of it; if it does not say how much that is, up to the end of its categories. It is the device's own afterwards.
    pub async fn read(&self) -> Result<Vec<u8>, EepromError> {
        let Self {
            registers, station, ..
        } = *self;
        let read = async {
            self.take().await?;
            let mut image = Image {
                registers,
                station,
                bytes: &mut Vec::new(),
            };
            let header = image.get(0..CATEGORIES).await?;
            let end = match SiiImage::room(&header) {
                Some(bytes) => bytes,
                None => image.end_of_categories().await?,
            };
            image.get(0..end).await
        };
        let read = read.await;
        give_away(registers, station).await?;
        read
    }

    /// Writes an image where these bytes were read. How many words, each of which was read back. It is the master's afterwards.
    pub async fn write(&self, before: &[u8], image: &SiiImage) -> Result<usize, EepromError> {
        self.take().await?;
        let words = image.writes_over(before);
        for (word, value) in &words {
            self.write_word(*word, *value).await?;
        }
        // The first one was a wrong checksum.
        Ok(words.len().saturating_sub(1))
    }

    /// Has the SubDevice load words 0 to 7 again, if it knows that command: its station alias after that. The EEPROM must belong to the
    /// master.
    pub async fn reload(&self) -> Result<u16, EepromError> {
        let Self {
            registers, station, ..
        } = *self;
        match execute(registers, station, RELOAD, 0, &[], self.limit).await {
            Ok((control, _)) if control & NOT_LOADED != 0 => {
                return Err(EepromError::NotLoaded { control });
            }
            Ok(_) | Err(EepromError::Refused { .. }) => {}
            Err(error) => return Err(error),
        }
        let alias = registers.read(station, esc::STATION_ALIAS).await?;
        Ok(u16::from_le_bytes(alias))
    }

    async fn take(&self) -> Result<(), EepromError> {
        self.registers
            .write(self.station, esc::EEPROM_CONFIGURATION, &OWNED_BY_MASTER)
            .await?;
        take_over(self.registers, self.station).await?;
        Ok(())
    }

    /// Writes one word, and reads it back. Control, address and data in one datagram, as IgH's master does.
    async fn write_word(&self, word: usize, expected: u16) -> Result<(), EepromError> {
        self.insist(WRITE, word, &expected.to_le_bytes()).await?;
        let (_, [low, high, ..]) = self.insist(READ, word, &[]).await?;
        match u16::from_le_bytes([low, high]) {
            got if got != expected => Err(EepromError::NotKept {
                word,
                expected,
                got,
            }),
            _ => Ok(()),
        }
    }

    /// Has a command executed, again and again while the EEPROM does not acknowledge.
    async fn insist(
        &self,
        command: u16,
        word: usize,
        data: &[u8],
    ) -> Result<(u16, [u8; 8]), EepromError> {
        let Self {
            registers,
            station,
            limit,
        } = *self;
        let time = registers.time();
        let started = time.now();
        loop {
            let done = execute(registers, station, command, word, data, limit).await;
            let is_over = time.now().saturating_sub(started) >= limit;
            match done {
                Err(EepromError::Refused { control, .. })
                    if control & NO_ACKNOWLEDGE != 0 && !is_over =>
                {
                    time.sleep(Duration::from_micros(500)).await;
                }
                done => return done,
            }
        }
    }
}

async fn read_words(
    registers: &Registers,
    station: u16,
    word: usize,
) -> Result<Vec<u8>, EepromError> {
    let (control, data) = execute(registers, station, READ, word, &[], LIMIT).await?;
    let length = if control & EIGHT_BYTES != 0 { 8 } else { 4 };
    Ok(data.iter().take(length).copied().collect())
}

/// Has a command executed: control and data after it. Data of a write go with the command, so that a frame that is sent again does the same.
async fn execute(
    registers: &Registers,
    station: u16,
    command: u16,
    word: usize,
    data: &[u8],
    limit: Duration,
) -> Result<(u16, [u8; 8]), EepromError> {
    let [a0, a1, a2, a3] = u32::try_from(word).unwrap_or(u32::MAX).to_le_bytes();
    let [c0, c1] = command.to_le_bytes();
    let written = [&[c0, c1, a0, a1, a2, a3], data].concat();
    registers
        .write(station, esc::EEPROM_CONTROL, &written)
        .await?;
    let (control, data) = settled(registers, station, word, limit).await?;
    match control & ERRORS {
        0 => Ok((control, data)),
        _ => Err(EepromError::Refused { word, control }),
    }
}

/// Control and data, once the EEPROM is not busy any more.
async fn settled(
    registers: &Registers,
    station: u16,
    word: usize,
    limit: Duration,
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
        if time.now().saturating_sub(started) >= limit {
            return Err(EepromError::Busy { word });
        }
        time.sleep(Duration::from_micros(100)).await;
    }
}
