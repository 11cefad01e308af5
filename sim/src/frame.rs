//! Where the datagrams of an EtherCAT frame are.
//! Layout: Ethernet header, EtherCAT header, then datagrams until one says that no more follow (ETG.1000.4).

use core::ops::Range;

/// Ethernet header: two addresses and the ethertype.
const ETHERNET_HEADER: usize = 14;
/// EtherCAT header: eleven bits of length, four bits of type.
const ETHERCAT_HEADER: usize = 2;
/// Datagram header: command, index, address, length, interrupt.
pub(crate) const DATAGRAM_HEADER: usize = 10;
/// Working counter behind the data.
pub(crate) const WORKING_COUNTER: usize = 2;
/// Ethertype of EtherCAT, as it is on the wire.
const ETHERTYPE: [u8; 2] = [0x88, 0xA4];
/// Type of an EtherCAT frame that holds datagrams.
const TYPE_DATAGRAMS: u16 = 1;

/// Whether this is an Ethernet frame of EtherCAT at all.
pub(crate) fn is_ethercat(frame: &[u8]) -> bool {
    frame.len() >= ETHERNET_HEADER + ETHERCAT_HEADER && frame.get(12..14) == Some(&ETHERTYPE[..])
}

/// Marks the frame as one that the first SubDevice has seen: bit 1 of the first byte of the source address.
pub(crate) fn mark_source(frame: &mut [u8]) {
    if let Some(byte) = frame.get_mut(6) {
        *byte |= 0x02;
    }
}

/// The datagrams that are completely there, each as the range of header, data and working counter.
///
/// A datagram that runs past the end that the EtherCAT header or the frame itself gives is not yielded, nor is anything
/// behind it.
pub(crate) fn datagrams(frame: &[u8]) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    let Some(header) = read_u16(frame, ETHERNET_HEADER) else {
        return found;
    };
    if header >> 12 != TYPE_DATAGRAMS {
        return found;
    }
    let mut at = ETHERNET_HEADER + ETHERCAT_HEADER;
    let end = frame.len().min(at + usize::from(header & 0x07FF));
    loop {
        let Some(length) = read_u16(frame, at + 6) else {
            return found;
        };
        let next = at + DATAGRAM_HEADER + usize::from(length & 0x07FF) + WORKING_COUNTER;
        if next > end {
            return found;
        }
        found.push(at..next);
        if length & 0x8000 == 0 {
            return found;
        }
        at = next;
    }
}

/// A little-endian word, when it is there.
pub(crate) fn read_u16(bytes: &[u8], at: usize) -> Option<u16> {
    let pair = bytes.get(at..at.checked_add(2)?)?;
    Some(u16::from_le_bytes(pair.try_into().ok()?))
}

/// A little-endian double word, when it is there.
pub(crate) fn read_u32(bytes: &[u8], at: usize) -> Option<u32> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(four.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two BRD datagrams of one byte each.
    fn two() -> Vec<u8> {
        let mut frame = vec![0xFF; 6];
        frame.extend([0x10; 6]);
        frame.extend([0x88, 0xA4, 26, 0x10]);
        frame.extend([7, 0, 0, 0, 0, 0, 1, 0x80, 0, 0, 0xAA, 0, 0]);
        frame.extend([7, 1, 0, 0, 0, 0, 1, 0x00, 0, 0, 0xBB, 0, 0]);
        frame
    }

    #[test]
    fn the_more_flag_leads_to_the_next_datagram() {
        assert_eq!(datagrams(&two()), vec![16..29, 29..42]);
    }

    #[test]
    fn a_cut_datagram_is_not_yielded() {
        let frame = two();
        assert_eq!(datagrams(&frame[..41]), vec![16..29]);
        assert_eq!(datagrams(&frame[..28]), vec![]);
    }

    #[test]
    fn the_length_in_the_ethercat_header_bounds_the_datagrams() {
        let mut frame = two();
        frame[14] = 13;
        assert_eq!(datagrams(&frame), vec![16..29]);
    }

    #[test]
    fn another_ethertype_is_no_ethercat_frame() {
        let mut frame = two();
        assert!(is_ethercat(&frame));
        frame[13] = 0xA5;
        assert!(!is_ethercat(&frame));
        assert!(!is_ethercat(&frame[..10]));
    }
}
