//! A cable that damages frames on their way.

use core::num::NonZeroU32;

use crate::esc::Esc;

/// A cable that damages frames on their way out.
pub(crate) struct BadCable {
    /// It is in front of this device.
    position: usize,
    /// It damages one of so many frames.
    every: NonZeroU32,
    frames: u32,
}

impl BadCable {
    /// `None` when it damages nothing.
    pub(crate) fn new(position: usize, every: u32) -> Option<Self> {
        Some(Self {
            position,
            every: NonZeroU32::new(every)?,
            frames: 0,
        })
    }

    /// In front of which device the next frame is damaged, if it is.
    pub(crate) fn damages(&mut self) -> Option<usize> {
        self.frames = (self.frames + 1) % self.every;
        (self.frames == 0).then_some(self.position)
    }
}

/// A frame was damaged in front of the device at this position: it finds that out and marks the frame, by which all others
/// know. Devices that no frame reaches count nothing.
pub(crate) fn count_damage<'a>(at: usize, line: impl Iterator<Item = (&'a mut Esc, bool)>) {
    for (position, (esc, reached)) in line.enumerate() {
        if reached {
            // Those in front of it see the frame on its way back, at port 1.
            esc.count_damaged_frame(u16::from(position < at), position != at);
        }
    }
}
