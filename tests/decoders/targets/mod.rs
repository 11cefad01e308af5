//! One function for each kind of bytes that come from outside: it decodes them, whatever they are, and panics if a promise
//! of the decoder is broken. The fuzzer (`fuzz/`) and the tests beside this run the same functions.

pub mod bus;
pub mod client;
pub mod esi;
pub mod information;
pub mod memory;
pub mod message;
pub mod sdo;
pub mod segment;
pub mod sii;
pub mod toml;

/// A target: what the fuzzer calls it, and its function.
pub type Target = (&'static str, fn(&[u8]));

/// All targets.
pub const ALL: [Target; 9] = [
    ("message", message::run),
    ("sdo", sdo::run),
    ("information", information::run),
    ("client", client::run),
    ("sii", sii::run),
    ("esi", esi::run),
    ("toml", toml::run),
    ("bus", bus::run),
    ("segment", segment::run),
];

/// An input as a script: single bytes, and parts that stand behind their length (one byte).
#[derive(Debug, Clone, Copy)]
pub struct Script<'a>(pub &'a [u8]);

impl<'a> Script<'a> {
    /// The next byte; 0 behind the end.
    pub fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else {
            return 0;
        };
        self.0 = rest;
        *first
    }

    /// The next two bytes, little-endian.
    pub fn word(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    /// The next part, or what is left of it.
    pub fn part(&mut self) -> &'a [u8] {
        let length = usize::from(self.byte()).min(self.0.len());
        let (part, rest) = self.0.split_at(length);
        self.0 = rest;
        part
    }

    /// Whether nothing is left.
    pub fn is_over(&self) -> bool {
        self.0.is_empty()
    }
}

impl<'a> Iterator for Script<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        (!self.is_over()).then(|| self.part())
    }
}

/// The script of these parts.
pub fn script<'a>(head: &[u8], parts: impl IntoIterator<Item = &'a [u8]>) -> Vec<u8> {
    let mut script = head.to_vec();
    for part in parts {
        let part = part.get(..255).unwrap_or(part);
        script.push(part.len() as u8);
        script.extend(part);
    }
    script
}
