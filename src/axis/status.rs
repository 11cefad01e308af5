//! The snapshot of an axis as the bus thread publishes it and handles read it: two copies, of which one is always whole.

use core::sync::atomic::{AtomicU64, AtomicUsize, Ordering, fence};

use super::Snapshot;
use crate::ds402::{Controlword, Mode, Statusword};

/// Words before the input bytes.
const HEAD: usize = 4;

/// Written by one thread, read by any number of others, without a lock: a reader that was overtaken reads again, the
/// writer never waits. It writes the copy that readers are not pointed to, so a writer that was interrupted holds nobody up.
#[derive(Debug)]
pub(crate) struct StatusCell {
    copies: [Copy; 2],
    latest: AtomicUsize,
}

#[derive(Debug)]
struct Copy {
    /// Odd while it is being written.
    sequence: AtomicU64,
    words: Box<[AtomicU64]>,
}

impl StatusCell {
    /// With room for this many input bytes.
    pub(crate) fn new(snapshot: &Snapshot, input_bytes: usize) -> Self {
        let copy = || Copy {
            sequence: AtomicU64::new(0),
            words: (0..HEAD + input_bytes.div_ceil(8))
                .map(|_| AtomicU64::new(0))
                .collect(),
        };
        let cell = Self {
            copies: [copy(), copy()],
            latest: AtomicUsize::new(0),
        };
        cell.publish(snapshot, &[]);
        cell
    }

    /// Makes these the latest. Only one thread may do this.
    pub(crate) fn publish(&self, snapshot: &Snapshot, inputs: &[u8]) {
        let next = 1 - self.latest.load(Ordering::Relaxed).min(1);
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
        for (word, value) in copy
            .words
            .iter()
            .zip(pack(snapshot).into_iter().chain(bytes))
        {
            word.store(value, Ordering::Relaxed);
        }
        copy.sequence
            .store((sequence | 1).wrapping_add(1), Ordering::Release);
        self.latest.store(next, Ordering::Release);
    }

    /// The latest snapshot.
    pub(crate) fn snapshot(&self) -> Snapshot {
        self.read(|words| {
            let mut head = [0; HEAD];
            for (to, from) in head.iter_mut().zip(words) {
                *to = from.load(Ordering::Relaxed);
            }
            unpack(head)
        })
    }

    /// Eight input bytes from `offset` on; those past the end are 0.
    pub(crate) fn inputs(&self, offset: usize) -> [u8; 8] {
        self.read(|words| {
            core::array::from_fn(|n| {
                let at = offset + n;
                let word = words
                    .get(HEAD + at / 8)
                    .map_or(0, |word| word.load(Ordering::Relaxed));
                (word >> (8 * (at % 8))) as u8
            })
        })
    }

    fn read<T>(&self, of: impl Fn(&[AtomicU64]) -> T) -> T {
        loop {
            let latest = self.latest.load(Ordering::Acquire);
            let copy = &self.copies[latest.min(1)];
            let before = copy.sequence.load(Ordering::Acquire);
            let value = of(&copy.words);
            fence(Ordering::Acquire);
            if before & 1 == 0 && copy.sequence.load(Ordering::Relaxed) == before {
                return value;
            }
            core::hint::spin_loop();
        }
    }
}

fn pack(snapshot: &Snapshot) -> [u64; HEAD] {
    let flags = [
        snapshot.answered,
        snapshot.lost,
        snapshot.halted,
        snapshot.has_set_point,
        snapshot.referenced,
    ]
    .into_iter()
    .rev()
    .fold(0u64, |flags, flag| flags << 1 | u64::from(flag));
    [
        snapshot.cycle,
        u64::from(snapshot.age) << 32 | flags,
        u64::from(snapshot.statusword.bits())
            | u64::from(snapshot.controlword.bits()) << 16
            | u64::from(snapshot.mode.raw().cast_unsigned()) << 32,
        u64::from(snapshot.position.cast_unsigned())
            | u64::from(snapshot.velocity.cast_unsigned()) << 32,
    ]
}

fn unpack([cycle, ages, words, motion]: [u64; HEAD]) -> Snapshot {
    let flag = |n: u32| ages >> n & 1 == 1;
    let statusword = Statusword::from_bits_retain(words as u16);
    Snapshot {
        cycle,
        age: (ages >> 32) as u32,
        answered: flag(0),
        lost: flag(1),
        halted: flag(2),
        has_set_point: flag(3),
        referenced: flag(4),
        statusword,
        state: statusword.state(),
        controlword: Controlword::from_bits_retain((words >> 16) as u16),
        mode: Mode::from_raw((words >> 32) as i8),
        position: motion as i32,
        velocity: (motion >> 32) as i32,
    }
}

#[cfg(test)]
mod tests {
    use std::{sync::Arc, thread};

    use super::*;

    fn snapshot(cycle: u64) -> Snapshot {
        let statusword = Statusword::from_bits_retain(cycle as u16);
        Snapshot {
            cycle,
            age: cycle as u32,
            answered: cycle.is_multiple_of(2),
            lost: cycle.is_multiple_of(3),
            statusword,
            state: statusword.state(),
            controlword: Controlword::from_bits_retain(cycle as u16),
            mode: Mode::from_raw(cycle as i8),
            position: -(cycle as i32),
            velocity: cycle as i32,
            halted: cycle.is_multiple_of(5),
            has_set_point: cycle.is_multiple_of(7),
            referenced: cycle.is_multiple_of(11),
        }
    }

    #[test]
    fn a_snapshot_comes_out_as_it_was_put_in() {
        let cell = StatusCell::new(&snapshot(0), 0);
        for cycle in 0..300 {
            cell.publish(&snapshot(cycle), &[]);
            assert_eq!(cell.snapshot(), snapshot(cycle));
        }
    }

    #[test]
    fn inputs_are_read_across_words_and_bytes_that_do_not_exist_are_zero() {
        let cell = StatusCell::new(&snapshot(1), 10);
        cell.publish(&snapshot(1), &[1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);
        assert_eq!(cell.inputs(6), [7, 8, 9, 10, 0, 0, 0, 0]);
        assert_eq!(cell.inputs(0), [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(cell.inputs(100), [0; 8]);
    }

    #[test]
    fn readers_never_see_a_mixture_of_two_cycles() {
        let cell = Arc::new(StatusCell::new(&snapshot(0), 8));
        let readers: Vec<_> = (0..2)
            .map(|_| {
                let cell = Arc::clone(&cell);
                thread::spawn(move || {
                    let mut last = 0;
                    while last < 20_000 {
                        let seen = cell.snapshot();
                        assert_eq!(seen, snapshot(seen.cycle));
                        assert!(seen.cycle >= last, "time does not go back");
                        last = seen.cycle;
                        let bytes = cell.inputs(0);
                        assert!(bytes.iter().all(|byte| *byte == bytes[0]));
                    }
                })
            })
            .collect();
        for cycle in 0..=20_000u64 {
            cell.publish(&snapshot(cycle), &[cycle as u8; 8]);
        }
        for reader in readers {
            reader.join().unwrap();
        }
    }
}
