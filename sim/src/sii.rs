//! The SII image (EEPROM) of a SubDevice, made from its description.
//! Layout: 64 words of configuration and identity, then categories up to the end mark FFFFh (ETG.1000.6, ETG.2010).

use crate::description::{Description, Direction, PdoDescription, SyncManagerUse};

/// Size of the EEPROM in bytes: 32 kbit.
const SIZE: usize = 4096;
/// Byte address of the first category.
const CATEGORIES: usize = 0x80;

const CATEGORY_STRINGS: u16 = 10;
const CATEGORY_GENERAL: u16 = 30;
const CATEGORY_FMMU: u16 = 40;
const CATEGORY_SYNC_MANAGER: u16 = 41;
const CATEGORY_TX_PDO: u16 = 50;
const CATEGORY_RX_PDO: u16 = 51;
const CATEGORY_CLOCK: u16 = 60;
/// First of the vendors' own categories.
const CATEGORY_VENDOR: u16 = 0x0800;
const CATEGORY_END: u16 = 0xFFFF;

/// The whole image.
pub(crate) fn image(description: &Description) -> Vec<u8> {
    let mut image = vec![0; CATEGORIES];
    put(&mut image, 0, &head(description));
    let mut strings = Strings::default();
    let general = general(description, &mut strings);
    let clock: Vec<u8> = description
        .clock_modes
        .iter()
        .flat_map(|mode| clock_mode(mode, &mut strings))
        .collect();
    let (vendors, others): (Vec<_>, Vec<_>) = description
        .other_categories
        .iter()
        .cloned()
        .partition(|(kind, _)| *kind >= CATEGORY_VENDOR);
    let tx_pdos = pdos(description, Direction::Inputs, &mut strings);
    let rx_pdos = pdos(description, Direction::Outputs, &mut strings);
    let mut numbered = vec![
        (CATEGORY_STRINGS, strings.bytes()),
        (CATEGORY_GENERAL, general),
        (CATEGORY_FMMU, description.fmmu_usage.clone()),
        (CATEGORY_SYNC_MANAGER, sync_managers(description)),
        (CATEGORY_TX_PDO, tx_pdos),
        (CATEGORY_RX_PDO, rx_pdos),
        (CATEGORY_CLOCK, clock),
    ];
    numbered.extend(others);
    numbered.sort_by_key(|(kind, _)| *kind);
    for (kind, data) in vendors.into_iter().chain(numbered) {
        category(&mut image, kind, &data);
    }
    image.extend(CATEGORY_END.to_le_bytes());
    image.resize(SIZE.max(image.len()), 0xFF);
    image
}

/// Checksum over the first seven words: CRC-8, polynomial 07h, start FFh.
pub(crate) fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0xFF, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc: u8, _| {
            if crc & 0x80 != 0 {
                crc << 1 ^ 0x07
            } else {
                crc << 1
            }
        })
    })
}

/// Words 0 to 3Fh.
fn head(description: &Description) -> Vec<u8> {
    let mut head = vec![0; CATEGORIES];
    // PDI control and configuration as in the SII of a real AKD; the ESC of this simulation does not use them.
    put(&mut head, 0, &[0x09, 0x00, 0x00, 0x08]);
    put(&mut head, 8, &description.alias.to_le_bytes());
    let crc = checksum(head.get(..14).unwrap_or(&[]));
    put(&mut head, 14, &[crc]);
    let identity = description.identity;
    for (at, value) in (0x10..).step_by(4).zip([
        identity.vendor,
        identity.product,
        identity.revision,
        identity.serial,
    ]) {
        put(&mut head, at, &value.to_le_bytes());
    }
    if let Some(mailbox) = description.mailbox {
        let words = [
            mailbox.out.0,
            mailbox.out.1,
            mailbox.input.0,
            mailbox.input.1,
            mailbox.protocols,
        ];
        for (at, word) in (0x30..).step_by(2).zip(words) {
            put(&mut head, at, &word.to_le_bytes());
        }
    }
    // Size in kbit less one, and the version of this layout.
    put(&mut head, 0x7C, &((SIZE / 128 - 1) as u16).to_le_bytes());
    put(&mut head, 0x7E, &1u16.to_le_bytes());
    head
}

/// Category 30.
fn general(description: &Description, strings: &mut Strings) -> Vec<u8> {
    let mut bytes = vec![0; 32];
    // The order text gets the first number, as in the SII of a real AKD: SOEM shows string 1 as the device's name.
    bytes[2] = strings.index(&description.order);
    bytes[0] = strings.index(&description.group);
    bytes[3] = strings.index(&description.name);
    bytes[5] = description.mailbox.map_or(0, |mailbox| mailbox.coe_details);
    // FoE and EoE, as a real AKD has them where its mailbox names these protocols.
    let protocols = description.mailbox.map_or(0, |mailbox| mailbox.protocols);
    bytes[6] = u8::from(protocols & 0x0008 != 0);
    bytes[7] = if protocols & 0x0002 != 0 { 0x03 } else { 0 };
    bytes[9] = description.ds402_channels;
    bytes[11] = flags(description);
    // Ports 0 and 1 are MII.
    bytes[16] = 0x11;
    bytes
}

/// Flags of category 30 (ETG.2010): SAFEOP can be entered without process data, LRW is not executed, messages that were lost
/// are sent again. A real AKD has the first and the last.
fn flags(description: &Description) -> u8 {
    let enable_safe_op = 0x01;
    let not_lrw = if description.supports_lrw { 0 } else { 0x02 };
    let mailbox_repeats = description.mailbox.map_or(0, |_| 0x04);
    enable_safe_op | not_lrw | mailbox_repeats
}

/// Category 41.
fn sync_managers(description: &Description) -> Vec<u8> {
    let mut bytes = Vec::new();
    for sm in &description.sync_managers {
        bytes.extend(sm.start.to_le_bytes());
        bytes.extend(sm.length.to_le_bytes());
        let kind = match sm.purpose {
            SyncManagerUse::MailboxOut => 1,
            SyncManagerUse::MailboxIn => 2,
            SyncManagerUse::Outputs => 3,
            SyncManagerUse::Inputs => 4,
        };
        bytes.extend([sm.control, 0, 1, kind]);
    }
    bytes
}

/// Category 50 or 51.
fn pdos(description: &Description, direction: Direction, strings: &mut Strings) -> Vec<u8> {
    description
        .pdos
        .iter()
        .filter(|pdo| pdo.direction == direction)
        .flat_map(|description| pdo(description, strings))
        .collect()
}

fn pdo(pdo: &PdoDescription, strings: &mut Strings) -> Vec<u8> {
    let mut bytes = pdo.index.to_le_bytes().to_vec();
    let count = u8::try_from(pdo.entries.len()).unwrap_or(u8::MAX);
    // Flag 10h: fixed content.
    let flags = if pdo.fixed { 0x10 } else { 0 };
    let name = strings.index_if_any(pdo.name);
    bytes.extend([count, pdo.sync_manager.unwrap_or(0xFF), 0, name, flags, 0]);
    for entry in pdo.entries.iter().take(usize::from(count)) {
        bytes.extend(entry.index.to_le_bytes());
        let name = strings.index_if_any(entry.name);
        bytes.extend([entry.subindex, name, entry.data_type, entry.bits, 0, 0]);
    }
    bytes
}

/// One mode of category 60.
fn clock_mode(mode: &crate::description::ClockMode, strings: &mut Strings) -> Vec<u8> {
    let mut bytes = vec![0; 24];
    put(&mut bytes, 14, &mode.assign_activate.to_le_bytes());
    // SYNC0 comes once a cycle of the MainDevice.
    put(&mut bytes, 16, &1u16.to_le_bytes());
    bytes[18] = strings.index(&mode.name);
    bytes
}

/// Appends a category, padded to whole words; an empty one is left out.
fn category(image: &mut Vec<u8>, kind: u16, data: &[u8]) {
    if data.is_empty() {
        return;
    }
    let words = u16::try_from(data.len().div_ceil(2)).unwrap_or(u16::MAX);
    image.extend(kind.to_le_bytes());
    image.extend(words.to_le_bytes());
    image.extend(data.iter().take(usize::from(words) * 2));
    if data.len() % 2 == 1 {
        image.push(0);
    }
}

fn put(image: &mut [u8], at: usize, bytes: &[u8]) {
    image
        .iter_mut()
        .skip(at)
        .zip(bytes)
        .for_each(|(target, byte)| *target = *byte);
}

/// The strings category; indices count from one, zero means none.
#[derive(Default)]
struct Strings(Vec<String>);

impl Strings {
    fn index(&mut self, text: &str) -> u8 {
        let position = self
            .0
            .iter()
            .position(|known| known == text)
            .unwrap_or_else(|| {
                self.0.push(text.to_owned());
                self.0.len() - 1
            });
        u8::try_from(position + 1).unwrap_or(0)
    }

    fn index_if_any(&mut self, text: &str) -> u8 {
        if text.is_empty() { 0 } else { self.index(text) }
    }

    fn bytes(&self) -> Vec<u8> {
        let mut bytes = vec![u8::try_from(self.0.len()).unwrap_or(u8::MAX)];
        for text in &self.0 {
            let length = u8::try_from(text.len()).unwrap_or(u8::MAX);
            bytes.push(length);
            bytes.extend(text.bytes().take(usize::from(length)));
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::description::Identity;

    #[test]
    fn the_checksum_is_the_one_of_a_real_drive() {
        // First eight words of a Kollmorgen AKD, public ethercrab repository, dumps/eeprom/akd.hex: checksum 10h.
        let head = [0x09, 0x00, 0x00, 0x08, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(checksum(&head), 0x10);
    }

    #[test]
    fn the_image_begins_with_checksum_and_identity() {
        let identity = Identity {
            vendor: 0x6A,
            product: 0x414B_4432,
            revision: 1,
            serial: 7,
        };
        let image = image(&Description::new("x", identity));
        assert_eq!(image[14], checksum(&image[..14]));
        assert_eq!(image[0x10..0x14], [0x6A, 0, 0, 0]);
        assert_eq!(image[0x14..0x18], [0x32, 0x44, 0x4B, 0x41]);
        assert_eq!(image[0x18..0x1C], [1, 0, 0, 0]);
        assert_eq!(image[0x1C..0x20], [7, 0, 0, 0]);
    }

    #[test]
    fn vendors_categories_come_first_the_others_by_number_and_the_end_mark_last() {
        let mut description = Description::new("name", Identity::default());
        description.fmmu_usage = vec![1, 2];
        description.other_categories =
            vec![(43, vec![0]), (0x0801, vec![1, 2, 3]), (0x0800, vec![4])];
        let image = image(&description);
        let mut kinds = Vec::new();
        let mut at = CATEGORIES;
        loop {
            let kind = u16::from_le_bytes([image[at], image[at + 1]]);
            kinds.push(kind);
            if kind == CATEGORY_END {
                break;
            }
            at += 4 + 2 * usize::from(u16::from_le_bytes([image[at + 2], image[at + 3]]));
        }
        assert_eq!(kinds, [0x0801, 0x0800, 10, 30, 40, 43, 0xFFFF]);
    }

    #[test]
    fn a_device_without_lrw_says_so_in_its_general_category() {
        let general = |supports_lrw| {
            let mut description = Description::new("x", Identity::default());
            description.supports_lrw = supports_lrw;
            super::general(&description, &mut Strings::default())
        };
        assert_eq!(general(true)[11] & 0x02, 0);
        assert_eq!(general(false)[11] & 0x02, 0x02);
    }

    #[test]
    fn the_order_text_is_string_1() {
        let image = image(crate::personality::akd2g().description());
        let at = image
            .windows(6)
            .position(|bytes| bytes == b"\x05AKD2G")
            .unwrap();
        assert_eq!(
            image[at - 5..at - 3],
            [10, 0],
            "category, then words and count"
        );
        assert_eq!(image[at + 6], 6);
    }

    #[test]
    fn mailboxes_and_sync_managers_have_the_bytes_of_a_real_drive() {
        // The same AKD, words 18h to 1Ch and the first two entries of category 41.
        let image = image(crate::personality::akd2g().description());
        assert_eq!(
            image[0x30..0x3A],
            [0x00, 0x18, 0x00, 0x04, 0x00, 0x1C, 0x00, 0x04, 0x0E, 0x00]
        );
        let expected = [
            0x00, 0x18, 0x00, 0x04, 0x26, 0x00, 0x01, 0x01, //
            0x00, 0x1C, 0x00, 0x04, 0x22, 0x00, 0x01, 0x02, 0x00, 0x11,
        ];
        let head = [41, 0, 16, 0];
        let at = image.windows(4).position(|window| window == head).unwrap();
        assert_eq!(image[at + 4..][..expected.len()], expected);
    }

    #[test]
    fn a_mapped_object_has_the_bytes_of_a_real_drive() {
        // The same AKD, category 50: object 6041h:0, 16 bits, type 6; only the number of its name differs.
        let image = image(crate::personality::akd2g().description());
        let entry = [0x41, 0x60, 0x00, 0x00, 0x06, 0x10, 0x00, 0x00];
        assert!(image.windows(8).any(|window| window == entry));
    }
}
