//! What is made of these is shared between the bus thread and the program. The models of `loom/` compile the same files with their own.

use std::{collections::VecDeque, sync::PoisonError};

use crossbeam_queue::ArrayQueue;

pub(crate) use core::{
    hint::spin_loop,
    sync::atomic::{AtomicBool, AtomicU8, AtomicU32, AtomicU64, AtomicUsize, Ordering, fence},
};
pub(crate) use std::sync::{Arc, Mutex, MutexGuard, OnceLock};

/// How many are kept.
const KEPT: usize = 64;

/// The latest of what happens on the bus thread, for who looks beside the program: the bus thread never waits for a reader.
#[derive(Debug)]
pub(crate) struct Recent<T> {
    fresh: ArrayQueue<(u64, T)>,
    /// Only readers share this.
    read: Mutex<VecDeque<(u64, T)>>,
    number: AtomicU64,
}

impl<T> Default for Recent<T> {
    fn default() -> Self {
        Self {
            fresh: ArrayQueue::new(KEPT),
            read: Mutex::default(),
            number: AtomicU64::new(0),
        }
    }
}

impl<T: Clone> Recent<T> {
    pub fn keep(&self, one: T) {
        let number = self.number.fetch_add(1, Ordering::Relaxed);
        drop(self.fresh.force_push((number, one)));
    }

    /// The latest, the oldest first, each with its number from 0.
    pub fn read(&self) -> Vec<(u64, T)> {
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        while let Some(one) = self.fresh.pop() {
            read.push_back(one);
        }
        let surplus = read.len().saturating_sub(KEPT);
        read.drain(..surplus);
        read.iter().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_are_kept_with_their_numbers() {
        let recent = Recent::default();
        for one in 0..100 {
            recent.keep(one);
            if one == 10 {
                assert_eq!(recent.read().len(), 11);
            }
        }
        let read = recent.read();
        assert_eq!(read.len(), KEPT);
        assert!(read.iter().all(|&(number, one)| number == one));
        assert_eq!(read.last(), Some(&(99, 99)));
    }
}
