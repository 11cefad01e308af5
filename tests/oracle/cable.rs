//! The cable between host and drive, and the host's own pauses (L1, L2).

use servocrab::axis::Inputs;

use crate::drive::Drive;
use crate::habits::{Habit, Habits, Hits};
use crate::random::Random;
use crate::words::{INPUT_BYTES, Outputs};

/// What the host is told of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Told {
    Fresh,
    Answered,
    Stale,
}

impl Told {
    pub const fn inputs(self, image: &[u8; INPUT_BYTES]) -> Inputs<'_> {
        match self {
            Self::Fresh => Inputs::Fresh(image),
            Self::Answered => Inputs::Answered(image),
            Self::Stale => Inputs::Stale,
        }
    }
}

/// What happens to a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    Good,
    RequestLost,
    ReplyLost,
    Late,
    Doubled,
    /// The working counter is wrong, and the drive has its outputs or not.
    Miscounted,
    Undelivered,
}

pub struct Cable {
    random: Random,
    habits: Habits,
    /// One frame in so many begins a burst; how many frames that has yet, and what becomes of them.
    rarity: u64,
    burst: u32,
    fate: Fate,
    /// Outputs on their way, and the frames until they are there. None overtakes another.
    under_way: Option<(Outputs, u32)>,
}

impl Cable {
    pub const TROUBLE: Habits = Habits::of(&[
        Habit::FramesLost,
        Habit::FramesLate,
        Habit::FramesDoubled,
        Habit::FramesMiscounted,
    ]);

    pub fn new(habits: Habits, mut random: Random) -> Self {
        Self {
            rarity: random.pick(&[40, 200, 1_000]),
            random,
            habits,
            burst: 0,
            fate: Fate::Good,
            under_way: None,
        }
    }

    pub fn heal(&mut self) {
        self.habits = Habits::default();
        self.fate = Fate::Good;
    }

    /// For how many cycles the host stands still now.
    pub fn pause(&mut self, hits: &mut Hits) -> u64 {
        if !self.habits.has(Habit::HostStands) || !self.random.one_in(1_000) {
            return 0;
        }
        hits.hit(Habit::HostStands);
        self.random.pick(&[2, 10, 60, 300, 1_200])
    }

    /// A cycle in which the host sends nothing.
    pub fn rest(&mut self, drive: &mut Drive) {
        if let Some((outputs, left)) = self.under_way {
            if left == 0 {
                drive.take(outputs);
            }
            self.under_way = left.checked_sub(1).map(|left| (outputs, left));
        }
    }

    /// One frame.
    pub fn pass(&mut self, outputs: Outputs, drive: &mut Drive, hits: &mut Hits) -> Told {
        if !self.habits.any(Self::TROUBLE) && self.under_way.is_none() {
            drive.take(outputs);
            return Told::Fresh;
        }
        self.choose(hits);
        let mut later = None;
        let (reaches, told) = match self.fate {
            Fate::Good => (true, Told::Fresh),
            Fate::RequestLost => (false, Told::Stale),
            Fate::ReplyLost => (true, Told::Stale),
            Fate::Late => {
                later = Some((outputs, self.random.below(3) as u32));
                (false, Told::Stale)
            }
            Fate::Doubled => {
                later = Some((outputs, 0));
                (true, Told::Stale)
            }
            Fate::Miscounted => (true, Told::Answered),
            Fate::Undelivered => (false, Told::Answered),
        };
        if reaches || later.is_some() {
            if let Some((before, _)) = self.under_way.take() {
                drive.take(before);
            }
            self.under_way = later;
            if reaches {
                drive.take(outputs);
            }
        } else {
            self.rest(drive);
        }
        told
    }

    fn choose(&mut self, hits: &mut Hits) {
        if self.burst > 0 {
            self.burst -= 1;
        } else if self.random.one_in(self.rarity) {
            self.burst = self.random.pick(&[0, 0, 0, 1, 3, 9, 12, 40]);
            let fates = [
                (Habit::FramesLost, Fate::RequestLost),
                (Habit::FramesLost, Fate::ReplyLost),
                (Habit::FramesLate, Fate::Late),
                (Habit::FramesDoubled, Fate::Doubled),
                (Habit::FramesMiscounted, Fate::Miscounted),
                (Habit::FramesMiscounted, Fate::Undelivered),
            ];
            let first = self.random.below(fates.len() as u64) as usize;
            let mut of = fates.iter().cycle().skip(first).take(fates.len());
            let fate = of.find(|(habit, _)| self.habits.has(*habit));
            self.fate = fate.map_or(Fate::Good, |(habit, fate)| {
                hits.hit(*habit);
                *fate
            });
        } else {
            self.fate = Fate::Good;
        }
    }
}
