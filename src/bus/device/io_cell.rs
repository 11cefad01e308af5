//! A device's inputs as the bus thread publishes them and handles read them: two copies, of which one is always whole.

use crate::sync::{AtomicU64, AtomicUsize, Ordering, fence, spin_loop};

/// The cycle, and what is known of the inputs.
const HEAD: usize = 2;

/// Written by one thread, read by any number of others, without a lock. It writes the copy that readers are not pointed to; a
/// reader that was overtaken reads again.
#[derive(Debug)]
pub(in crate::bus) struct Cell {
    copies: [Copy; 2],
    latest: AtomicUsize,
}

#[derive(Debug)]
struct Copy {
    /// Odd while it is being written.
    sequence: AtomicU64,
    words: Box<[AtomicU64]>,
}

/// What is known of the inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(in crate::bus) struct Head {
    pub cycle: u64,
    /// Cycles since the inputs came; none if they never did.
    pub age: Option<u32>,
    pub lost: bool,
    pub operational: bool,
    pub delivered: bool,
}

impl Cell {
    /// With room for this many input bytes.
    pub fn new(inputs: usize) -> Self {
        let copy = || Copy {
            sequence: AtomicU64::new(0),
            words: (0..HEAD + inputs.div_ceil(8))
                .map(|_| AtomicU64::new(0))
                .collect(),
        };
        Self {
            copies: [copy(), copy()],
            latest: AtomicUsize::new(0),
        }
    }

    /// Makes these the latest. Only one thread may do this.
    pub fn publish(&self, head: Head, inputs: &[u8]) {
        let next = usize::from(self.latest.load(Ordering::Relaxed) == 0);
        let Some(copy) = self.copies.get(next) else {
            return;
        };
        let sequence = copy.sequence.load(Ordering::Relaxed);
        copy.sequence.store(sequence | 1, Ordering::Relaxed);
        fence(Ordering::Release);
        let bytes = inputs.chunks(8).map(|chunk| {
            let mut word = [0; 8];
            for (to, from) in word.iter_mut().zip(chunk) {
                *to = *from;
            }
            u64::from_le_bytes(word)
        });
        for (word, value) in copy.words.iter().zip(head.words().into_iter().chain(bytes)) {
            word.store(value, Ordering::Relaxed);
        }
        let whole = (sequence | 1).wrapping_add(1);
        copy.sequence.store(whole, Ordering::Release);
        self.latest.store(next, Ordering::Release);
    }

    /// Makes this the latest head, of the inputs that were the latest. Only one thread may do this.
    pub fn publish_again(&self, head: Head) {
        let latest = self.latest.load(Ordering::Relaxed);
        let words = self.copies[latest.min(1)].words.iter().skip(HEAD);
        let bytes: Vec<u8> = words
            .flat_map(|word| word.load(Ordering::Relaxed).to_le_bytes())
            .collect();
        self.publish(head, &bytes);
    }

    /// The latest, with eight input bytes from `offset` on; those past the end are 0.
    pub fn read(&self, offset: usize) -> (Head, [u8; 8]) {
        loop {
            let latest = self.latest.load(Ordering::Acquire);
            let copy = &self.copies[latest.min(1)];
            let before = copy.sequence.load(Ordering::Acquire);
            let word = |at: usize| {
                let word = copy.words.get(at);
                word.map_or(0, |word| word.load(Ordering::Relaxed))
            };
            let head = [word(0), word(1)];
            let inputs = std::array::from_fn(|n| {
                let at = offset + n;
                (word(HEAD + at / 8) >> (8 * (at % 8))) as u8
            });
            fence(Ordering::Acquire);
            if before & 1 == 0 && copy.sequence.load(Ordering::Relaxed) == before {
                return (Head::of_words(head), inputs);
            }
            spin_loop();
        }
    }
}

impl Head {
    fn words(self) -> [u64; HEAD] {
        let flags = [
            self.age.is_some(),
            self.lost,
            self.operational,
            self.delivered,
        ];
        let flags = flags
            .into_iter()
            .rev()
            .fold(0, |flags, flag| flags << 1 | u64::from(flag));
        [self.cycle, u64::from(self.age.unwrap_or(0)) << 32 | flags]
    }

    fn of_words([cycle, word]: [u64; HEAD]) -> Self {
        let flag = |n: u32| word >> n & 1 == 1;
        Self {
            cycle,
            age: flag(0).then_some((word >> 32) as u32),
            lost: flag(1),
            operational: flag(2),
            delivered: flag(3),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{sync::Arc, thread};

    use super::{Cell, Head};

    fn head(cycle: u64) -> Head {
        Head {
            cycle,
            age: (!cycle.is_multiple_of(2)).then_some(cycle as u32),
            lost: cycle.is_multiple_of(3),
            operational: cycle.is_multiple_of(5),
            delivered: cycle.is_multiple_of(7),
        }
    }

    #[test]
    fn readers_never_see_a_mixture_of_two_cycles() {
        let cell = Arc::new(Cell::new(16));
        let reader = {
            let cell = Arc::clone(&cell);
            thread::spawn(move || {
                let mut last = 0;
                while last < 20_000 {
                    let (seen, bytes) = cell.read(5);
                    if seen.cycle != 0 {
                        assert_eq!(seen, head(seen.cycle));
                    }
                    assert_eq!(bytes, [seen.cycle as u8; 8]);
                    assert!(seen.cycle >= last, "time does not go back");
                    last = seen.cycle;
                }
            })
        };
        for cycle in 1..=20_000u64 {
            cell.publish(head(cycle), &[cycle as u8; 16]);
        }
        reader.join().unwrap();
        assert_eq!(cell.read(10).1[6..], [0, 0], "past the end");
    }
}
