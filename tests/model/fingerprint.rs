//! What tells two states of a core apart: all that it says of itself, with instants as ages.

use core::fmt::{self, Write};
use core::time::Duration;

use servocrab::axis::AxisCore;

/// The clock of a model starts here: every instant in a core is later, and every time span is shorter.
pub const START: Duration = Duration::from_secs(1_000_000);

/// Collects what a core says of itself.
#[derive(Default)]
pub struct Fingerprint {
    text: String,
}

impl Fingerprint {
    /// The fingerprint of a core at this time, with what else belongs to the state. Instants count as ages, not longer than
    /// `longest`.
    pub fn of(
        &mut self,
        core: &AxisCore,
        now: Duration,
        longest: Duration,
        more: &impl fmt::Debug,
    ) -> u128 {
        self.text.clear();
        // Writing to a string does not fail.
        let _ = write!(self.text, "{more:?}|{core:?}");
        let mut hash = Hash::new();
        let bytes = self.text.as_bytes();
        // What the axis was configured with is the same in every state.
        let configured = find(bytes, b"config: AxisConfig", 0);
        let rest = configured.and_then(|from| find(bytes, b"bounds: ", from));
        let skipped = configured.zip(rest).map_or(0..0, |(from, to)| from..to);
        let mut at = 0;
        while at < bytes.len() {
            if at == skipped.start && !skipped.is_empty() {
                at = skipped.end;
            }
            let byte = bytes[at];
            if !byte.is_ascii_digit() || (at > 0 && is_word(bytes[at - 1])) {
                if byte == b'c'
                    && bytes[at..].starts_with(b"cycle: ")
                    && bytes[at.saturating_sub(1)] == b' '
                {
                    // Counts without end.
                    at += b"cycle: ".len();
                    while bytes.get(at).is_some_and(u8::is_ascii_digit) {
                        at += 1;
                    }
                    continue;
                }
                if byte == b'n' && bytes[at..].starts_with(b"news: ") {
                    // What its port was told is no part of what it does.
                    at += b"news: ".len();
                    while bytes.get(at).is_some_and(u8::is_ascii_alphabetic) {
                        at += 1;
                    }
                    continue;
                }
                hash.add(byte);
                at += 1;
                continue;
            }
            let mut end = at;
            while bytes
                .get(end)
                .is_some_and(|byte| byte.is_ascii_digit() || *byte == b'.')
            {
                end += 1;
            }
            let seconds = bytes.get(end) == Some(&b's')
                && !bytes.get(end + 1).is_some_and(|byte| is_word(*byte));
            let instant = seconds.then(|| instant(&bytes[at..end])).flatten();
            match instant {
                Some(instant) => {
                    hash.add(b'@');
                    let age = now.as_nanos() as i128 - instant as i128;
                    let most = longest.as_nanos() as i128;
                    for byte in age.clamp(-most, most).to_le_bytes() {
                        hash.add(byte);
                    }
                    at = end + 1;
                }
                None => {
                    for &byte in &bytes[at..end] {
                        hash.add(byte);
                    }
                    at = end;
                }
            }
        }
        hash.0
    }
}

fn is_word(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_'
}

fn find(bytes: &[u8], what: &[u8], from: usize) -> Option<usize> {
    (from..bytes.len().saturating_sub(what.len())).find(|&at| bytes[at..].starts_with(what))
}

/// Seconds with a fraction as nanoseconds, if they are an instant of the model's clock.
fn instant(text: &[u8]) -> Option<u128> {
    let text = core::str::from_utf8(text).ok()?;
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let whole: u128 = whole.parse().ok()?;
    if whole < START.as_secs().into() || fraction.len() > 9 {
        return None;
    }
    let nanos: u128 = format!("{fraction:0<9}").parse().ok()?;
    Some(whole * 1_000_000_000 + nanos)
}

/// FNV-1a of 128 bits.
struct Hash(u128);

impl Hash {
    const fn new() -> Self {
        Self(0x6c62_272e_07bb_0142_62b8_2175_6295_c58d)
    }

    const fn add(&mut self, byte: u8) {
        self.0 = (self.0 ^ byte as u128).wrapping_mul(0x0000_0000_0100_0000_0000_0000_0000_013B);
    }
}

#[test]
fn ages_are_the_same_at_another_time_and_other_numbers_are_not() {
    use servocrab::axis::{AxisConfig, AxisFields, Command, CommandId, Inputs};
    let at = |later: u64, position: i32, wait: u64| {
        let mut core = AxisCore::new(AxisConfig::new(AxisFields::at(0, 0)));
        let mut outputs = [0; 6];
        let now = START + Duration::from_millis(later);
        core.submit(now, CommandId(1), Command::Enable, &mut outputs);
        let mut inputs = [0x50, 0x02, 0, 0, 0, 0];
        inputs[2..].copy_from_slice(&position.to_le_bytes());
        for _ in 0..3 {
            core.step(now, Inputs::Fresh(&inputs), &mut outputs);
        }
        while core.poll_event().is_some() {}
        let mut print = Fingerprint::default();
        print.of(
            &core,
            now + Duration::from_millis(wait),
            Duration::from_secs(60),
            &(),
        )
    };
    assert_eq!(at(0, 7, 0), at(123_456, 7, 0));
    assert_ne!(at(0, 7, 0), at(0, 8, 0));
    assert_ne!(at(0, 7, 0), at(0, 7, 1));
}
