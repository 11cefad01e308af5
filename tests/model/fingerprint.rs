//! What tells two states apart: all that a core and its surroundings are, by their derived `Hash`, names in the order in which they come, and of
//! a state and its mirror image one.

use core::hash::{Hash, Hasher};

/// Names begin here: every other number of 32 bits in a core is smaller, or `u32::MAX`.
const NAMES: u32 = 0x7A00_0000;
/// At most so many.
pub const MOST: usize = 6;

/// The number that a core is told for a name, as an id and as a velocity. From 1.
pub const fn number(name: u8) -> u32 {
    NAMES + name as u32
}

/// The name behind such a number.
pub fn name(number: u32) -> Option<u8> {
    let name = number.checked_sub(NAMES)?;
    (1..=MOST as u32).contains(&name).then_some(name as u8)
}

/// Takes a state in, and its mirror image at the same time: what has a sign has the other one there.
#[derive(Clone)]
pub struct Fingerprint {
    straight: Mixed,
    mirrored: Mixed,
    names: [u8; MOST],
    named: usize,
}

impl Fingerprint {
    pub fn new() -> Self {
        Self {
            straight: Mixed::new(),
            mirrored: Mixed::new(),
            names: [0; MOST],
            named: 0,
        }
    }

    /// The names in the order in which they came.
    pub fn names(&self) -> ([u8; MOST], usize) {
        (self.names, self.named)
    }

    /// Of a state and its mirror image the same.
    pub fn value(&self) -> u128 {
        self.straight.value().min(self.mirrored.value())
    }

    fn both(&mut self, word: u64) {
        self.straight.add(word);
        self.mirrored.add(word);
    }

    fn signed(&mut self, value: i64) {
        self.straight.add(value as u64);
        self.mirrored.add(value.wrapping_neg() as u64);
    }

    fn order(&mut self, name: u8) -> usize {
        let known = self.names[..self.named].iter().position(|&n| n == name);
        known.unwrap_or_else(|| {
            self.names[self.named] = name;
            self.named += 1;
            self.named - 1
        })
    }
}

impl Hasher for Fingerprint {
    fn finish(&self) -> u64 {
        self.value() as u64
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.both(byte.into());
        }
    }

    fn write_u8(&mut self, value: u8) {
        self.both(value.into());
    }

    fn write_u16(&mut self, value: u16) {
        self.both(value.into());
    }

    fn write_u32(&mut self, value: u32) {
        if let Some(name) = name(value) {
            let order = self.order(name);
            self.both(u64::from(NAMES) + order as u64);
        } else {
            self.both(value.into());
        }
    }

    fn write_u64(&mut self, value: u64) {
        self.both(value);
    }

    fn write_usize(&mut self, value: usize) {
        self.both(value as u64);
    }

    fn write_isize(&mut self, value: isize) {
        self.both(value as u64);
    }

    fn write_i8(&mut self, value: i8) {
        self.both(value as u64);
    }

    fn write_i16(&mut self, value: i16) {
        self.both(value as u64);
    }

    fn write_i32(&mut self, value: i32) {
        self.signed(value.into());
    }

    fn write_i64(&mut self, value: i64) {
        self.signed(value);
    }
}

/// Two words that every word changes.
#[derive(Clone)]
struct Mixed(u64, u64);

impl Mixed {
    const fn new() -> Self {
        Self(0x243F_6A88_85A3_08D3, 0x1319_8A2E_0370_7344)
    }

    #[inline(always)]
    fn add(&mut self, word: u64) {
        self.0 = folded(self.0 ^ word, 0x9E37_79B9_7F4A_7C15);
        self.1 = folded(self.1.rotate_left(23) ^ word, 0xD6E8_FEB8_6659_FD93);
    }

    fn value(&self) -> u128 {
        let ends = Self(self.0 ^ self.1.rotate_left(32), self.1);
        u128::from(folded(ends.0, 0xA409_3822_299F_31D1)) << 64
            | u128::from(folded(ends.1, 0x082E_FA98_EC4E_6C89))
    }
}

#[inline(always)]
fn folded(a: u64, b: u64) -> u64 {
    let product = u128::from(a) * u128::from(b);
    // Without the sum a zero would stay one.
    (product as u64) ^ ((product >> 64) as u64).wrapping_add(a.rotate_left(17))
}

/// Of anything that has a `Hash`.
pub fn of(state: &impl Hash) -> Fingerprint {
    let mut print = Fingerprint::new();
    state.hash(&mut print);
    print
}

#[test]
fn a_state_is_the_same_at_another_time_with_another_name_and_mirrored() {
    use core::time::Duration;
    use servocrab::axis::{AxisCore, AxisFields, Command, CommandId, CoreConfig, Inputs};
    let at = |later: u64, position: i32, name: u8, cycles: u64| {
        let mut core = AxisCore::new(CoreConfig::new(AxisFields::at(0, 0)));
        let mut outputs = [0; 6];
        let at = |cycle| Duration::from_millis(later + cycle);
        core.step(at(0), Inputs::Stale, &mut outputs);
        core.submit(
            at(0),
            CommandId(number(name)),
            Command::Enable,
            &mut outputs,
        );
        let mut inputs = [0x50, 0x02, 0, 0, 0, 0];
        inputs[2..].copy_from_slice(&position.to_le_bytes());
        for cycle in 1..=cycles {
            core.step(at(cycle), Inputs::Fresh(&inputs), &mut outputs);
        }
        while core.poll_event().is_some() {}
        of(&core).value()
    };
    let first = at(0, 7, 1, 3);
    assert_eq!(first, at(123_456, 7, 1, 3), "at another time");
    assert_eq!(first, at(0, 7, 3, 3), "with another name");
    assert_eq!(first, at(0, -7, 1, 3), "mirrored");
    assert_ne!(first, at(0, 8, 1, 3));
    assert_ne!(first, at(0, 7, 1, 4), "a cycle later");
}

#[test]
fn a_mirrored_part_is_another_state() {
    let at = |a: i32, b: i32| of(&(a, b)).value();
    assert_eq!(at(1, 2), at(-1, -2));
    assert_ne!(at(1, 2), at(-1, 2));
    assert_ne!(at(1, 2), at(2, 1));
}
