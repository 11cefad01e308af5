//! What drives, cables and hosts do, by name: within the fault model, and beyond it.

/// Which of the two a scenario keeps to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    Inside,
    Outside,
}

impl Side {
    /// Even seeds are inside.
    pub const fn of(seed: u64) -> Self {
        if seed & 1 == 0 {
            Self::Inside
        } else {
            Self::Outside
        }
    }
}

/// Names each habit once, those within the model first.
macro_rules! habits {
    (inside { $($(#[$doc:meta])* $name:ident,)* } outside { $($(#[$beyond_doc:meta])* $beyond:ident,)* }) => {
        /// One habit of a drive, its cable or the host.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Habit {
            $($(#[$doc])* $name,)*
            $($(#[$beyond_doc])* $beyond,)*
        }

        /// Those that docs/fault-model.md has.
        pub const MODEL: &[Habit] = &[$(Habit::$name,)*];

        /// Those beyond it.
        pub const BEYOND: &[Habit] = &[$(Habit::$beyond,)*];
    };
}

habits! {
    inside {
        /// Sets off some time after the acknowledge, with bit 10 low (S3).
        StartDelay,
        /// The same, with bit 10 of the rest before until it sets off (S3).
        StartDelayShownReached,
        /// Stands between two set-points, with bit 10 high or low (S3).
        Dwell,
        /// Bit 12 is high for one of its cycles alone (S1).
        AckOfOneCycle,
        /// Bit 12 falls 100 ms after bit 4.
        AckOf100Ms,
        /// Bit 12 rises some time after the set-point was taken.
        AckLate,
        /// A set-point is taken, and bit 12 does not rise (S1).
        AckMissing,
        /// A rise of bit 4 does nothing (S1).
        EdgeIgnored,
        /// Bit 12 is high for a while after enabling.
        AckAtEnable,
        /// Bit 10 is wrong for at most one drive cycle (D1).
        Bit10Wrong,
        /// Bit 11 is (D1).
        Bit11Wrong,
        /// Bit 12 is (D1).
        Bit12Wrong,
        /// Bit 10 of the rest before stays for up to two drive cycles after the beginning.
        Bit10Stale,
        /// Bit 10 by the actual position, so that it falls again where the axis swings out of the window (S4).
        Bit10ByWindow,
        /// The statusword, 6061h, 6064h and 606Ch are of different times (D2).
        Skew,
        /// Fault reaction active, then Operation enabled again with everything gone (D4).
        FaultReactionLeft,
        /// A fault that ends by itself.
        FaultResetsItself,
        /// A fault with a ramp.
        Fault,
        /// A fault that switches off at once.
        FaultCoasts,
        /// Stops by itself (D4).
        OwnQuickStop,
        /// Switches off by itself (D4).
        OwnSwitchOff,
        /// Falls to Switched on by itself (D4).
        OwnDisable,
        /// Is enabled by somebody else (D4).
        OwnEnable,
        /// Takes its time in each transition.
        PowerLate,
        /// Stays for a while where it is told to go on.
        Inhibited,
        /// Takes its time to show a mode.
        ModeLate,
        /// A halt drops the set-points, as its description says (S6).
        HaltForgets,
        /// Bit 10 stays low at a halt (S7).
        HaltWithoutBit10,
        /// Limits set-points to a range that the core does not know (S5).
        Limits,
        /// Limits set-points on their way (S5).
        Clamps,
        /// An input of its own holds the axis on its way, with bit 10 low, and lets it go on.
        Held,
        /// Outputs come into effect up to three ticks late (D3).
        OutputsLate,
        /// Inputs are up to three ticks old.
        InputsLate,
        /// Its own cycle is two to four of the bus.
        SlowCycle,
        /// 6064h is never quiet (A3).
        Dither,
        /// The axis overshoots and swings.
        Overshoot,
        /// The axis follows late and slowly.
        Creeps,
        /// 606Ch is never quiet.
        VelocityNoise,
        /// 000 in bits 13, 12 and 10 at rest in homing mode.
        HomingShowsProgress,
        /// Bit 10 stays low at the end of a homing.
        HomingWithoutBit10,
        /// Bit 13 at the end of a homing.
        HomingFails,
        /// Frames are lost (L1).
        FramesLost,
        /// Frames reach the drive up to three cycles late, and their answers count for nothing (L1).
        FramesLate,
        /// Frames pass the drive twice, and their answers count for nothing (L1).
        FramesDoubled,
        /// Frames are miscounted, and the outputs in some of them lost (L1).
        FramesMiscounted,
        /// The host stands still, and the drive does not (L2).
        HostStands,
    }
    outside {
        /// One statusword of another state.
        WrongWord,
        /// The same, for two to five cycles.
        WrongWords,
        /// One of bits 10, 11 and 12 is wrong for two to five drive cycles.
        WrongBits,
        /// 6061h shows another mode for some cycles.
        ModeFlaps,
        /// Fault reaction active, then Operation enabled again with its set-points kept.
        FaultReactionLeftMoving,
        /// Comes back into Operation enabled before another state was seen.
        LeavesUnseen,
        /// Drops its set-points without a sign.
        Forgets,
        /// A halt drops the set-points, though its description says that it keeps them.
        HaltForgetsUntold,
        /// Takes its time in each transition, those that lead down among them.
        ObeysLate,
        /// Bit 8 does nothing.
        HaltIgnored,
        /// Bit 2 does nothing.
        QuickStopIgnored,
        /// Stands for a single sample where it limits a set-point.
        ClampOfOneSample,
        /// Begins after `Deadlines::begin`.
        BeginsTooLate,
        /// Goes on to the next end before the axis is at this one.
        GoesOnEarly,
        /// Something pushes the axis.
        Push,
        /// The shaft is blocked for a while.
        Blocked,
        /// Obeys nothing for a while: it is under local control.
        LocalControl,
    }
}

/// The name of every habit, in the order of their numbers.
pub fn all() -> impl Iterator<Item = Habit> {
    MODEL.iter().chain(BEYOND).copied()
}

const COUNT: usize = MODEL.len() + BEYOND.len();

/// Some of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Habits(pub u64);

impl Habits {
    pub const fn has(self, habit: Habit) -> bool {
        self.0 >> habit as u8 & 1 != 0
    }

    pub const fn of(habits: &[Habit]) -> Self {
        let (mut set, mut at) = (Self(0), 0);
        while at < habits.len() {
            set = set.with(habits[at]);
            at += 1;
        }
        set
    }

    pub const fn any(self, of: Self) -> bool {
        self.0 & of.0 != 0
    }

    #[must_use]
    pub const fn with(self, habit: Habit) -> Self {
        Self(self.0 | 1 << habit as u8)
    }

    pub fn iter(self) -> impl Iterator<Item = Habit> {
        all().filter(move |habit| self.has(*habit))
    }
}

/// How often each was hit.
#[derive(Debug, Clone)]
pub struct Hits([u64; COUNT]);

impl Default for Hits {
    fn default() -> Self {
        Self([0; COUNT])
    }
}

impl Hits {
    pub const fn hit(&mut self, habit: Habit) {
        self.0[habit as usize] += 1;
    }

    pub const fn of(&self, habit: Habit) -> u64 {
        self.0[habit as usize]
    }

    pub fn add(&mut self, other: &Self) {
        for (mine, theirs) in self.0.iter_mut().zip(other.0) {
            *mine += theirs;
        }
    }
}
