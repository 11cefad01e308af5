//! The files of vectors: lines of columns, `|` between them, `#` before comments.

/// An EEPROM, 2 KiB.
pub(crate) fn akd_eeprom() -> Vec<u8> {
    let mut image = Vec::new();
    for row in rows(include_str!("../../vectors/akd_eeprom.txt")) {
        assert_eq!(usize::from(number(row[0])), image.len());
        image.extend(bytes(row[1]));
    }
    assert!(image.ends_with(&[0xFF, 0xFF]));
    image.resize(2048, 0xFF);
    image
}

/// The columns of each line that is no comment.
pub(crate) fn rows(table: &'static str) -> impl Iterator<Item = Vec<&'static str>> {
    table
        .lines()
        .filter(|line| !line.trim().is_empty() && !line.starts_with('#'))
        .map(|line| line.split('|').map(str::trim).collect())
}

/// A hexadecimal number.
pub(crate) fn number(text: &str) -> u16 {
    u16::from_str_radix(text.trim_end_matches('h'), 16).expect("a hexadecimal number")
}

/// Hexadecimal bytes with spaces between them; `7A*5` is five times 7Ah.
pub(crate) fn bytes(text: &str) -> Vec<u8> {
    text.split_whitespace()
        .flat_map(|part| {
            let (byte, times) = part.split_once('*').unwrap_or((part, "1"));
            let byte = u8::from_str_radix(byte, 16).expect("a hexadecimal byte");
            vec![byte; times.parse().expect("a number of times")]
        })
        .collect()
}

/// One request and what answered it, as whole messages.
pub(crate) struct Exchange {
    /// The object that is read or written, or what else is asked.
    pub(crate) what: &'static str,
    pub(crate) value: Vec<u8>,
    pub(crate) request: Vec<u8>,
    pub(crate) reply: Vec<u8>,
}

/// SOEM reads the mapping of an AKD: each is an upload of `what`, which gives `value`.
pub(crate) fn akd_exchanges() -> Vec<Exchange> {
    rows(include_str!("../../vectors/akd_sdo_mails.txt"))
        .map(|row| Exchange {
            what: row[0],
            value: bytes(row[1]),
            request: bytes(row[2]),
            reply: bytes(row[3]),
        })
        .collect()
}

/// SOEM and a simulated drive of other people.
pub(crate) fn pp_drive_exchanges() -> Vec<Exchange> {
    rows(include_str!("../../vectors/pp_drive_mails.txt"))
        .map(|row| Exchange {
            what: row[0],
            value: Vec::new(),
            request: bytes(row[1]),
            reply: bytes(row[2]),
        })
        .collect()
}

/// The simulated AKD2G's answers to the same.
pub(crate) fn simulated_exchanges() -> Vec<Exchange> {
    rows(include_str!("../../vectors/simulated_answers.txt"))
        .map(|row| Exchange {
            what: row[0],
            value: Vec::new(),
            request: bytes(row[1]),
            reply: bytes(row[2]),
        })
        .collect()
}

/// An object written as `1C12h:1`.
pub(crate) fn object(text: &str) -> (u16, u8) {
    let (index, subindex) = text.split_once(':').expect("index and subindex");
    (number(index), subindex.parse().expect("a subindex"))
}
