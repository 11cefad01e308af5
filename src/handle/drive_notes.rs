//! What the program and the bus thread tell each other of the objects of an axis' drive.

use core::sync::atomic::{
    AtomicBool, AtomicU16, AtomicU32, AtomicU64,
    Ordering::{AcqRel, Acquire, Release},
};
use std::sync::{Mutex, PoisonError};

use crossbeam_queue::ArrayQueue;

use crate::{axis::DriveSettings, profile_position::Limits};

#[derive(Debug)]
pub(super) struct DriveNotes {
    /// How often the drive was brought up, or led back, with what it held at the first start.
    starts: AtomicU64,
    /// What the drive held when it was attached last, until a handle asks, and since.
    new_settings: ArrayQueue<DriveSettings>,
    settings: Mutex<DriveSettings>,
    /// 6061h as the program has read it by SDO.
    pub mode: Noted,
    /// Home offset 607Ch as the program has written or read it.
    pub home_offset: Noted,
    /// Whether the drive may hold another home offset: the answer to a write of it is not there, or was given up.
    pub home_offset_in_doubt: AtomicBool,
    limits_changed: AtomicU64,
    /// Max and min profile velocity, 607Fh and 2010h, as the core checks jogs; 0 is no limit.
    max_velocity: AtomicU32,
    min_velocity: AtomicU16,
}

/// A value from the program for the bus thread: the last one counts.
#[derive(Debug, Default)]
pub(super) struct Noted(AtomicU64);

/// Set above a value that is there.
const NOTED: u64 = 1 << 32;

impl Noted {
    fn set(&self, value: i32) {
        let noted = NOTED | u64::from(value.cast_unsigned());
        self.0.store(noted, Release);
    }

    /// What was noted since the last call.
    pub fn take(&self) -> Option<i32> {
        let is_noted = self.0.load(Acquire) & NOTED != 0;
        is_noted.then(|| self.0.swap(0, AcqRel) as i32)
    }
}

impl DriveNotes {
    pub fn new(settings: DriveSettings) -> Self {
        Self {
            starts: AtomicU64::new(0),
            new_settings: ArrayQueue::new(2),
            settings: Mutex::new(settings),
            mode: Noted::default(),
            home_offset: Noted::default(),
            home_offset_in_doubt: AtomicBool::new(false),
            limits_changed: AtomicU64::new(0),
            max_velocity: AtomicU32::new(0),
            min_velocity: AtomicU16::new(0),
        }
    }

    /// The bus thread has read this from the drive. No reader holds it up.
    pub fn set_settings(&self, held: DriveSettings) {
        self.new_settings.force_push(held);
    }

    /// For the program's side alone.
    pub fn settings(&self) -> DriveSettings {
        let mut known = self.settings.lock().unwrap_or_else(PoisonError::into_inner);
        while let Some(new) = self.new_settings.pop() {
            *known = new;
        }
        *known
    }

    /// The drive begins again and holds this: what was noted before is gone.
    pub fn restart(&self, held: DriveSettings) {
        self.starts.fetch_add(1, AcqRel);
        self.set_settings(held);
        self.mode.take();
        self.home_offset.take();
        self.note_limits_changed();
        self.home_offset_in_doubt.store(false, Release);
    }

    /// Which start of the axis this is.
    pub fn starts(&self) -> u64 {
        self.starts.load(Acquire)
    }

    /// The program has read this from 6061h.
    pub fn note_mode(&self, raw: i8) {
        self.mode.set(raw.into());
    }

    /// The drive has this home offset 607Ch, in this start of the axis. One from before a recovery may be gone, and was read again.
    pub fn note_home_offset(&self, start: u64, offset: i32) {
        if start == self.starts() {
            self.home_offset_in_doubt.store(false, Release);
            self.home_offset.set(offset);
            self.note_limits_changed();
        }
    }

    /// The core checks jogs against these.
    pub fn note_velocities(&self, limits: &Limits) {
        let (max, min) = (limits.max_velocity, limits.min_velocity);
        self.max_velocity.store(max.unwrap_or(0), Release);
        self.min_velocity.store(min.unwrap_or(0), Release);
    }

    /// What was noted last, and no other limit.
    pub fn velocities(&self) -> Limits {
        Limits {
            max_velocity: Some(self.max_velocity.load(Acquire)),
            min_velocity: Some(self.min_velocity.load(Acquire)),
            ..Limits::trust_drive()
        }
    }

    /// Limits that a task is reading are to be read again.
    pub fn note_limits_changed(&self) {
        self.limits_changed.fetch_add(1, AcqRel);
    }

    /// Another number after limits were read says that they may be old ones.
    pub fn limits_changed(&self) -> u64 {
        self.limits_changed.load(Acquire)
    }
}
