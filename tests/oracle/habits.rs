//! What drives do that the standard permits, or that it does not forbid, by name.

/// Names each habit once, in the order of [`ALL`].
macro_rules! habits {
    ($($(#[$meaning:meta])* $name:ident,)*) => {
        /// One habit of a drive or of its cable.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(u8)]
        pub enum Habit {
            $($(#[$meaning])* $name,)*
        }

        /// All of them.
        pub const ALL: &[Habit] = &[$(Habit::$name,)*];
    };
}

habits! {
    /// Sets off some time after the acknowledge: a brake, an input of its own.
    StartDelay,
    /// The same, with bit 10 of the rest before until it sets off.
    StartDelayShownReached,
    /// Bit 12 is high for one of its cycles alone.
    AckOfOneCycle,
    /// Bit 12 falls 100 ms after bit 4.
    AckOf100Ms,
    /// Bit 12 rises some time after the set-point was taken.
    AckLate,
    /// Bit 12 is high for a while after enabling.
    AckAtEnable,
    /// Bit 10 is high for one cycle on the way, and where one move is blended into the next.
    Bit10Glitch,
    /// Bit 10 of the rest before stays for some cycles after the acknowledge.
    Bit10Stale,
    /// Bit 10 by the actual position, so that it may come while the axis creeps, and fall again.
    Bit10ByWindow,
    /// One statusword of another state.
    WrongWord,
    /// The same, for two to five cycles.
    WrongWords,
    /// Fault reaction active, then Operation enabled again with everything gone.
    FaultReactionLeft,
    /// The same, with its set-points kept.
    FaultReactionLeftMoving,
    /// A fault that ends by itself.
    FaultResetsItself,
    /// A fault with a ramp.
    Fault,
    /// A fault that switches off at once.
    FaultCoasts,
    /// 6061h shows another mode for some cycles.
    ModeFlaps,
    /// Bit 8 does nothing.
    HaltIgnored,
    /// A halt drops the set-points.
    HaltForgets,
    /// Bit 10 stays low at a halt.
    HaltWithoutBit10,
    /// Outputs come into effect up to three ticks late.
    OutputsLate,
    /// Inputs are up to three ticks old.
    InputsLate,
    /// Stands between two queued moves, with bit 10.
    Dwell,
    /// 6064h is never quiet.
    Dither,
    /// The axis overshoots and swings.
    Overshoot,
    /// The axis follows late and slowly.
    Creeps,
    /// 606Ch is never quiet.
    VelocityNoise,
    /// Stops by itself.
    OwnQuickStop,
    /// Switches off by itself.
    OwnSwitchOff,
    /// Falls to Switched on by itself.
    OwnDisable,
    /// Frames are lost.
    FramesLost,
    /// Frames are miscounted, and the outputs in some of them lost.
    FramesMiscounted,
    /// Its own cycle is two to four of the bus.
    SlowCycle,
    /// Bit 2 does nothing.
    QuickStopIgnored,
    /// Something pushes the axis.
    LoadStep,
    /// 000 in bits 13, 12 and 10 at rest in homing mode.
    HomingShowsProgress,
    /// Bit 10 stays low at the end of a homing.
    HomingWithoutBit10,
    /// Bit 13 at the end of a homing.
    HomingFails,
    /// Takes its time to show a mode.
    ModeLate,
    /// Takes its time in each transition.
    PowerLate,
    /// An input of its own holds the axis on its way, with bit 10 low, and lets it go on.
    Held,
    /// One statusword of the right state shows a free place in a full buffer, or a result of a homing under way.
    WrongBits,
}

/// Those of the first scenarios. What a kept seed draws stays the same.
pub const FIRST: &[Habit] = ALL.split_at(Habit::Held as usize).0;

/// And of the next.
pub const SECOND: &[Habit] = ALL.split_at(Habit::WrongBits as usize).0;

/// Some of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Habits(pub u64);

impl Habits {
    pub const fn has(self, habit: Habit) -> bool {
        self.0 >> habit as u8 & 1 != 0
    }

    #[must_use]
    pub const fn with(self, habit: Habit) -> Self {
        Self(self.0 | 1 << habit as u8)
    }

    #[must_use]
    pub const fn without(self, habit: Habit) -> Self {
        Self(self.0 & !(1 << habit as u8))
    }

    pub fn iter(self) -> impl Iterator<Item = Habit> {
        ALL.iter().copied().filter(move |habit| self.has(*habit))
    }
}

/// How often each was hit.
#[derive(Debug, Clone)]
pub struct Hits(pub [u64; ALL.len()]);

impl Default for Hits {
    fn default() -> Self {
        Self([0; ALL.len()])
    }
}

impl Hits {
    pub const fn hit(&mut self, habit: Habit) {
        self.0[habit as usize] += 1;
    }

    pub fn add(&mut self, other: &Self) {
        for (mine, theirs) in self.0.iter_mut().zip(other.0) {
            *mine += theirs;
        }
    }
}
