//! The snapshot of an axis as the bus thread publishes it and handles read it: two copies, of which one is always whole.

use super::Snapshot;
use crate::{
    coe::Number,
    ds402::{Controlword, Mode, Statusword},
    pdo_map::{self, BitRange},
    sync::{AtomicU64, AtomicUsize, Ordering, fence, spin_loop},
};

/// Words before the input bytes.
const HEAD: usize = 4;
/// A snapshot in so many words: the cycle; age and flags; statusword, controlword and mode; position and velocity.
pub(super) type Head = [u64; HEAD];
const ANSWERED: u64 = 1;

/// Written by one thread, read by any number of others, without a lock: a reader that was overtaken reads again, the
/// writer never waits. It writes the copy that readers are not pointed to, so a writer that was interrupted holds nobody up.
#[derive(Debug)]
pub(super) struct StatusCell {
    copies: [Copy; 2],
    /// How often a snapshot was published: the latest is in the second copy where that is odd.
    published: AtomicUsize,
}

#[derive(Debug)]
struct Copy {
    head: [AtomicU64; HEAD],
    inputs: Box<[AtomicU64]>,
}

impl StatusCell {
    /// With room for this many input bytes.
    pub fn new(snapshot: &Snapshot, input_bytes: usize) -> Self {
        let copy = || Copy {
            head: Default::default(),
            inputs: (0..input_bytes.div_ceil(8))
                .map(|_| AtomicU64::new(0))
                .collect(),
        };
        let cell = Self {
            copies: [copy(), copy()],
            published: AtomicUsize::new(0),
        };
        cell.publish(pack(snapshot), Some(&[]));
        cell
    }

    /// Makes these the latest; without inputs, those that were published last stay. Only one thread may do this.
    #[inline]
    pub fn publish(&self, head: Head, inputs: Option<&[u8]>) {
        let published = self.published.load(Ordering::Relaxed);
        let next = published.wrapping_add(1);
        let copy = self.copy(next);
        // A reader of what is written from here on sees as well that another copy is the latest since.
        fence(Ordering::Release);
        for (word, value) in copy.head.iter().zip(head) {
            word.store(value, Ordering::Relaxed);
        }
        match inputs {
            Some(inputs) => copy.take(inputs),
            None => {
                for (word, last) in copy.inputs.iter().zip(&self.copy(published).inputs) {
                    word.store(last.load(Ordering::Relaxed), Ordering::Relaxed);
                }
            }
        }
        self.published.store(next, Ordering::Release);
    }

    /// Another cycle that has shown nothing else that is new.
    #[inline]
    pub fn tick(&self, cycle: u64) {
        let latest = self.copy(self.published.load(Ordering::Relaxed));
        // The other words of this copy are those of every cycle since it was written.
        latest.head[0].store(cycle, Ordering::Relaxed);
    }

    /// What `of` makes of the snapshot that was published last and of its inputs.
    pub fn sample<T>(&self, of: impl Fn(Snapshot, &SampledInputs<'_>) -> T) -> T {
        self.read(|copy| {
            let head = copy.head.each_ref();
            let head = head.map(|word| word.load(Ordering::Relaxed));
            of(unpack(head), &SampledInputs(copy))
        })
    }

    fn read<T>(&self, of: impl Fn(&Copy) -> T) -> T {
        loop {
            let published = self.published.load(Ordering::Acquire);
            let value = of(self.copy(published));
            fence(Ordering::Acquire);
            // This copy is written again only after another one was published.
            if self.published.load(Ordering::Relaxed) == published {
                return value;
            }
            spin_loop();
        }
    }

    /// Where the snapshot is that was published as this one.
    #[inline]
    fn copy(&self, published: usize) -> &Copy {
        let [first, second] = &self.copies;
        if published.is_multiple_of(2) {
            first
        } else {
            second
        }
    }
}

/// The input bytes that belong to a snapshot.
pub(super) struct SampledInputs<'a>(&'a Copy);

impl SampledInputs<'_> {
    /// The value at this place; 0 where there is nothing.
    pub fn value<T: Number>(&self, field: pdo_map::Field<T>) -> T {
        let place = field.place();
        let bytes = self.bytes(place.byte);
        let at_start = pdo_map::Field::new(BitRange { byte: 0, ..place });
        at_start
            .and_then(|field| field.read(&bytes))
            .unwrap_or(T::from_raw(0))
    }

    /// Eight bytes from `offset` on; those past the end are 0.
    pub fn bytes(&self, offset: usize) -> [u8; 8] {
        core::array::from_fn(|n| {
            let at = offset + n;
            let word = self.0.inputs.get(at / 8);
            let word = word.map_or(0, |word| word.load(Ordering::Relaxed));
            (word >> (8 * (at % 8))) as u8
        })
    }
}

impl Copy {
    #[inline]
    fn take(&self, inputs: &[u8]) {
        // The inputs of an axis are seldom of another length: no loop for those.
        if (9..=16).contains(&inputs.len())
            && let [first, second] = &*self.inputs
            && let (Some(head), Some(end)) = (inputs.first_chunk(), inputs.last_chunk())
        {
            first.store(u64::from_le_bytes(*head), Ordering::Relaxed);
            let behind = u64::from_le_bytes(*end) >> (8 * (16 - inputs.len()));
            second.store(behind, Ordering::Relaxed);
        } else {
            self.take_words(inputs);
        }
    }

    #[inline(never)]
    fn take_words(&self, inputs: &[u8]) {
        let (chunks, rest) = inputs.as_chunks::<8>();
        for (chunk, word) in chunks.iter().zip(&self.inputs) {
            word.store(u64::from_le_bytes(*chunk), Ordering::Relaxed);
        }
        if !rest.is_empty()
            && let Some(word) = self.inputs.get(chunks.len())
        {
            word.store(last_word(inputs, rest), Ordering::Relaxed);
        }
    }
}

/// The last bytes of these, of which there are one to seven, and zeros behind them.
#[inline]
fn last_word(bytes: &[u8], last: &[u8]) -> u64 {
    match bytes.last_chunk() {
        // In one go, with some of those before them.
        Some(end) => u64::from_le_bytes(*end) >> (64 - 8 * last.len()),
        None => {
            let bytes = last.iter().rev();
            bytes.fold(0, |word, byte| word << 8 | u64::from(*byte))
        }
    }
}

/// Position and velocity as a word of a [`Head`].
pub(super) const fn motion(position: i32, velocity: i32) -> u64 {
    position.cast_unsigned() as u64 | (velocity.cast_unsigned() as u64) << 32
}

/// The second word of a [`Head`] after so many cycles without inputs, from that of before.
pub(super) const fn silent(word: u64, age: u32) -> u64 {
    (word as u32 as u64) & !ANSWERED | (age as u64) << 32
}

/// Whether anything changed that a handle may wait for; cycles and their age count for themselves.
pub(super) const fn differs(last: &Head, new: &Head) -> bool {
    last[1] as u32 != new[1] as u32 || last[2] != new[2] || last[3] != new[3]
}

pub(super) fn pack(snapshot: &Snapshot) -> Head {
    let flags = [
        snapshot.answered,
        snapshot.lost,
        snapshot.halted,
        snapshot.has_set_point,
        snapshot.referenced,
        snapshot.slipped,
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
        motion(snapshot.position, snapshot.velocity),
    ]
}

fn unpack([cycle, ages, words, motion]: Head) -> Snapshot {
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
        slipped: flag(5),
        statusword,
        state: statusword.state(),
        controlword: Controlword::from_bits_retain((words >> 16) as u16),
        mode: Mode::from_raw((words >> 32) as i8),
        position: motion as i32,
        velocity: (motion >> 32) as i32,
        following_error: None,
        torque: None,
        error_code: None,
    }
}

#[cfg(test)]
mod tests {
    use std::{cell::Cell, sync::Arc, thread};

    use super::*;

    fn snapshot(cycle: u64) -> Snapshot {
        let statusword = Statusword::from_bits_retain(cycle as u16);
        Snapshot {
            following_error: None,
            torque: None,
            error_code: None,
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
            slipped: cycle.is_multiple_of(13),
        }
    }

    #[test]
    fn a_snapshot_comes_out_as_it_was_put_in() {
        let cell = StatusCell::new(&snapshot(0), 0);
        for cycle in 0..300 {
            cell.publish(pack(&snapshot(cycle)), Some(&[]));
            assert_eq!(cell.sample(|snapshot, _| snapshot), snapshot(cycle));
        }
    }

    #[test]
    fn inputs_are_read_across_words_and_bytes_that_do_not_exist_are_zero() {
        let cell = StatusCell::new(&snapshot(1), 10);
        cell.publish(pack(&snapshot(1)), Some(&[1, 2, 3, 4, 5, 6, 7, 8, 9, 10]));
        assert_eq!(
            cell.sample(|_, inputs| inputs.bytes(6)),
            [7, 8, 9, 10, 0, 0, 0, 0]
        );
        assert_eq!(
            cell.sample(|_, inputs| inputs.bytes(0)),
            [1, 2, 3, 4, 5, 6, 7, 8]
        );
        assert_eq!(cell.sample(|_, inputs| inputs.bytes(100)), [0; 8]);
    }

    #[test]
    fn bytes_behind_the_last_whole_word_stay_in_their_places() {
        let bytes: Vec<u8> = (1..=24).collect();
        for length in 0..=24 {
            let cell = StatusCell::new(&snapshot(1), length);
            cell.publish(pack(&snapshot(1)), Some(&bytes[..length]));
            let seen: Vec<u8> = (0..4)
                .flat_map(|word| cell.sample(|_, inputs| inputs.bytes(8 * word)))
                .collect();
            assert_eq!(seen[..length], bytes[..length]);
            assert!(seen[length..].iter().all(|byte| *byte == 0));
        }
    }

    #[test]
    fn a_reader_that_was_overtaken_reads_again() {
        let cell = StatusCell::new(&snapshot(0), 0);
        let reads = Cell::new(0);
        let read = cell.read(|copy| {
            let cycle = copy.head[0].load(Ordering::Relaxed);
            if reads.replace(reads.get() + 1) == 0 {
                cell.publish(pack(&snapshot(1)), None);
                cell.publish(pack(&snapshot(2)), None);
            }
            (cycle, copy.head[3].load(Ordering::Relaxed))
        });
        let [cycle, _, _, motion] = pack(&snapshot(2));
        assert_eq!((read, reads.get()), ((cycle, motion), 2));
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
                        let seen = cell.sample(|snapshot, _| snapshot);
                        assert_eq!(seen, snapshot(seen.cycle));
                        assert!(seen.cycle >= last, "time does not go back");
                        last = seen.cycle;
                        let bytes = cell.sample(|_, inputs| inputs.bytes(0));
                        assert!(bytes.iter().all(|byte| *byte == bytes[0]));
                    }
                })
            })
            .collect();
        for cycle in 0..=20_000u64 {
            cell.publish(pack(&snapshot(cycle)), Some(&[cycle as u8; 8]));
        }
        for reader in readers {
            reader.join().unwrap();
        }
    }
}
