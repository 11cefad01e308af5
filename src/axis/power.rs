//! The power side of an axis: which state it is led to, and who waits for that.

use core::time::Duration;

use crate::{
    ds402::{PowerCommand, PowerGoal, Sample, State, Statusword, next_command},
    profile_position::{CommandId, Traits, no_older},
};

/// Edges of bit 7 that one reset sends at most.
pub(super) const RESET_EDGES: u8 = 3;

/// How long bit 7 stays low between two edges: some drives stop answering when it toggles faster than about ten times a
/// second (seen in a public master for real drives).
pub(super) const RESET_PAUSE: Duration = Duration::from_millis(100);

/// Where the axis is led to.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) enum Power {
    /// Voltage disabled.
    Off,
    /// Shut down to Ready to switch on, where it was enabled before.
    Ready,
    /// On the way down, somebody waits.
    Disabling {
        id: CommandId,
        goal: PowerGoal,
        deadline: Duration,
    },
    /// On the way to Operation enabled. What was enabled by somebody else before is left first. `shown`: since when each sample has shown
    /// that state, after it was ordered.
    Enabling {
        id: CommandId,
        deadline: Duration,
        was_down: bool,
        shown: Option<Duration>,
    },
    /// In Operation enabled, by our command.
    Enabled,
    /// In Quick stop active, standing.
    Holding,
    /// Resetting a fault.
    Resetting {
        id: CommandId,
        phase: ResetPhase,
        edges: u8,
    },
}

/// Where bit 7 is.
#[derive(Debug, Clone, Copy, Hash)]
pub(super) enum ResetPhase {
    /// Low at least until then, and until that was delivered, Fault is surely shown and the axis stands, for which there is a
    /// deadline. Since when Fault is shown.
    Low {
        until: Duration,
        reaction: Duration,
        shown: Option<Duration>,
    },
    /// High until then, or until the fault is gone.
    High { until: Duration },
    /// Low, since no fault is shown any more: since when, and until when the drive may take to Switch on disabled.
    Gone { since: Duration, until: Duration },
}

impl Power {
    /// Whether the drive follows, or may follow, set-points of ours.
    pub const fn is_driving(&self) -> bool {
        matches!(self, Self::Enabled)
    }

    /// Whether the bits of the mode go into the controlword.
    pub const fn allows_mode_bits(&self) -> bool {
        matches!(self, Self::Enabled)
    }

    /// Whether the drive is led, or stays led, to Operation enabled.
    pub const fn leads_up(&self) -> bool {
        matches!(self, Self::Enabled | Self::Enabling { was_down: true, .. })
    }

    /// Whether this command of it takes, or may take, the axis' power.
    pub const fn leads_down(&self, command: PowerCommand) -> bool {
        match command {
            PowerCommand::DisableVoltage => true,
            PowerCommand::Shutdown | PowerCommand::SwitchOn => !self.leads_up(),
            PowerCommand::EnableOperation | PowerCommand::QuickStop | PowerCommand::FaultReset => {
                false
            }
        }
    }

    /// The command that leads on from `state`.
    #[inline]
    pub fn command(&self, state: State, sample: Option<&Sample>, traits: &Traits) -> PowerCommand {
        match self {
            Self::Off => PowerCommand::DisableVoltage,
            Self::Ready => next_command(state, PowerGoal::Ready),
            Self::Disabling { goal, .. } => next_command(state, *goal),
            Self::Enabling {
                was_down: false, ..
            } => PowerCommand::DisableVoltage,
            Self::Enabling { .. } => {
                let voltage =
                    sample.is_some_and(|s| s.statusword.contains(Statusword::VOLTAGE_ENABLED));
                if state == State::ReadyToSwitchOn && traits.shows_voltage && !voltage {
                    PowerCommand::Shutdown
                } else {
                    next_command(state, PowerGoal::Enabled)
                }
            }
            Self::Enabled => PowerCommand::EnableOperation,
            Self::Holding => PowerCommand::QuickStop,
            Self::Resetting {
                phase: ResetPhase::High { .. },
                ..
            } => PowerCommand::FaultReset,
            Self::Resetting { .. } => PowerCommand::DisableVoltage,
        }
    }

    /// Ends what somebody waits for, with the voltage disabled; says who waited.
    pub fn take_waiter(&mut self) -> Option<CommandId> {
        match *self {
            Self::Disabling { id, .. } | Self::Enabling { id, .. } | Self::Resetting { id, .. } => {
                *self = Self::Off;
                Some(id)
            }
            _ => None,
        }
    }
}

// Whether a word that leads down may take the axis' power: only from one that stands.
//
// A statusword of one cycle may be wrong, and the axis move all the same. As long as the drive may be driving an axis that does
// not stand, quick stop goes out in place of every word that leads down. In the states without power both lead to the same.

/// What is known of the drive's power stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
enum BrakePhase {
    /// Nothing yet.
    #[default]
    Unknown,
    /// It holds or drives the axis, or has done so, and the axis has not been seen to stand since.
    Driven,
    /// It drives nothing, and the axis has not been seen to stand since it did.
    Coasting,
    /// It drives nothing, and moves the axis by nothing that it did before.
    Free,
}

/// What brakes the axis before its power goes.
#[derive(Debug, Clone, Copy, Hash, Default)]
pub(super) struct Brake {
    phase: BrakePhase,
    /// Until when quick stop is sent for an axis that does not come to rest.
    until: Option<Duration>,
    /// Since when each sample has shown a state without power, and how many there were.
    down: Option<(Duration, u32)>,
    /// Since when a word that does not enable it is known to have been delivered, with none sent after that which does.
    led_down: Option<Duration>,
    over: bool,
    /// Whether it has surely shown a state without power, and whether it was led there.
    shown: bool,
    confirmed: bool,
    /// Whether the last sample showed Quick stop active.
    stopping: bool,
}

impl Brake {
    /// A word was sent. A drive that shows a state without power by mistake, and has not got one that leads it there, may hold a set-point.
    pub fn note_sent(&mut self, now: Duration, enables: bool, delivered: bool) {
        if enables {
            self.led_down = None;
        } else if delivered {
            self.led_down.get_or_insert(now);
        }
    }

    /// Takes in one sample of a drive with these traits. `leading_down`: the axis is to lose its power. `patience` is how long it may
    /// take to come to rest.
    #[inline]
    pub fn update(
        &mut self,
        now: Duration,
        state: State,
        standing: bool,
        leading_down: bool,
        traits: &Traits,
        patience: Duration,
    ) {
        let powered = is_powered(state);
        let stopping = state == State::QuickStopActive;
        if stopping && !self.stopping {
            // It stops the axis from now on, however long it did not.
            self.until = None;
            self.over = false;
        }
        self.stopping = stopping;
        self.down = match self.down {
            _ if powered => None,
            None => Some((now, 1)),
            Some((since, samples)) => Some((since, samples.saturating_add(1))),
        };
        let seen = |since| now.saturating_sub(since) >= traits.surely_seen();
        self.shown = self
            .down
            .is_some_and(|(since, samples)| samples > 1 && seen(since));
        self.confirmed = self.shown && self.led_down.is_some_and(seen);
        if powered {
            self.phase = BrakePhase::Driven;
        } else if standing || (self.confirmed && self.phase == BrakePhase::Unknown) {
            self.phase = BrakePhase::Free;
        } else if self.confirmed && self.over {
            self.phase = BrakePhase::Coasting;
        }
        if standing || !leading_down || !self.may_drive() {
            self.until = None;
            self.over = false;
        } else {
            let until = *self.until.get_or_insert(now.saturating_add(patience));
            self.over |= now >= until;
        }
    }

    /// Lets go of what makes no difference any more.
    pub fn canonicalize(&mut self, now: Duration, seen: Duration) {
        if let Some((since, samples)) = &mut self.down {
            no_older(since, now, seen);
            *samples = (*samples).min(2);
        }
        if let Some(since) = &mut self.led_down {
            no_older(since, now, seen);
        }
        if let Some(until) = &mut self.until {
            *until = (*until).max(now);
        }
    }

    /// The drive ignores quick stop.
    pub const fn give_up(&mut self) {
        self.over = true;
    }

    /// Whether quick stop goes out in place of a word that leads down. One that stood when it showed itself without power may set off for what
    /// the drive holds: words may be wrong.
    pub const fn holds(&self, standing: bool) -> bool {
        !standing && !self.over && (!self.confirmed || self.may_drive())
    }

    /// Whether the drive may be driving the axis. One that coasts has had its time to come to rest.
    pub const fn may_drive(&self) -> bool {
        !matches!(self.phase, BrakePhase::Coasting | BrakePhase::Free)
    }

    /// Whether the drive drives nothing, and the axis does not run on from what it did.
    pub const fn is_free(&self) -> bool {
        matches!(self.phase, BrakePhase::Free)
    }

    /// Whether a sample like the last one changes nothing.
    pub const fn allows_idle_path(&self, driving: bool) -> bool {
        match self.phase {
            BrakePhase::Unknown | BrakePhase::Coasting => false,
            BrakePhase::Driven => driving && self.down.is_none() && self.until.is_none(),
            BrakePhase::Free => self.confirmed,
        }
    }

    /// Whether the drive has surely shown that its power stage is off: a single word may be wrong.
    pub const fn is_shown_down(&self) -> bool {
        self.shown
    }

    /// Whether the drive has surely shown that its power stage is off, and was led there.
    pub const fn is_down(&self) -> bool {
        self.confirmed
    }
}

/// Whether the drive follows set-points in this state, or stops the axis.
const fn is_powered(state: State) -> bool {
    matches!(
        state,
        State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive
    )
}

#[cfg(test)]
mod brake_tests {
    use super::*;

    const CYCLE: Duration = Duration::from_millis(1);
    const PATIENCE: Duration = Duration::from_millis(20);

    /// A brake, stepped each millisecond, of a drive that has surely seen a word after two.
    struct Axis {
        brake: Brake,
        now: Duration,
        traits: Traits,
        /// Whether what is sent enables it, and whether the axis is to lose its power.
        enables: bool,
        leading_down: bool,
    }

    impl Axis {
        /// Driven, and moving.
        fn driven() -> Self {
            let mut axis = Self {
                brake: Brake::default(),
                now: Duration::ZERO,
                traits: Traits {
                    drive_cycle: CYCLE,
                    ..Traits::cia402()
                },
                enables: true,
                leading_down: false,
            };
            axis.cycle(State::OperationEnabled, false);
            axis
        }

        /// The same, and led down from now on.
        fn led_down() -> Self {
            Self {
                enables: false,
                leading_down: true,
                ..Self::driven()
            }
        }

        fn cycle(&mut self, state: State, standing: bool) {
            self.now += CYCLE;
            self.brake.note_sent(self.now, self.enables, true);
            self.brake.update(
                self.now,
                state,
                standing,
                self.leading_down,
                &self.traits,
                PATIENCE,
            );
        }

        fn cycles(&mut self, cycles: usize, state: State) {
            for _ in 0..cycles {
                self.cycle(state, false);
            }
        }
    }

    #[test]
    fn one_of_which_nothing_was_seen_may_be_driven() {
        let brake = Brake::default();
        assert!(brake.may_drive() && brake.holds(false) && !brake.is_free());
    }

    #[test]
    fn a_moving_axis_is_held_until_it_stands_without_power() {
        let mut axis = Axis::led_down();
        assert!(axis.brake.may_drive() && axis.brake.holds(false));
        assert!(!axis.brake.holds(true));
        axis.cycles(2, State::SwitchOnDisabled);
        assert!(axis.brake.holds(false));
        axis.cycle(State::SwitchOnDisabled, true);
        assert!(!axis.brake.may_drive() && !axis.brake.holds(false));
        // Whatever moves it now is not the drive.
        axis.cycle(State::SwitchOnDisabled, false);
        assert!(!axis.brake.may_drive());
        axis.cycle(State::OperationEnabled, false);
        assert!(axis.brake.may_drive());
    }

    /// It sets off for what the drive holds still, with wrong words before one that leads it down was delivered.
    #[test]
    fn one_that_stood_without_power_is_held_until_it_was_surely_led_down() {
        let mut axis = Axis::driven();
        axis.cycle(State::OperationEnabled, true);
        axis.cycle(State::SwitchedOn, true);
        assert!(!axis.brake.holds(true));
        for _ in 0..10 {
            axis.cycle(State::SwitchedOn, false);
            assert!(axis.brake.holds(false));
        }
        axis.enables = false;
        axis.cycles(2, State::SwitchedOn);
        assert!(axis.brake.holds(false));
        axis.cycle(State::SwitchedOn, false);
        assert!(!axis.brake.holds(false));
    }

    #[test]
    fn one_that_stands_with_its_power_may_be_driven() {
        for state in [
            State::OperationEnabled,
            State::QuickStopActive,
            State::FaultReactionActive,
        ] {
            let mut axis = Axis::led_down();
            axis.cycle(state, true);
            assert!(axis.brake.may_drive(), "{state:?}");
        }
    }

    #[test]
    fn the_power_is_surely_off_when_that_was_shown_and_led_to_for_two_cycles_of_the_drive() {
        let mut axis = Axis::led_down();
        axis.cycles(2, State::SwitchOnDisabled);
        assert!(!axis.brake.is_down());
        axis.cycle(State::SwitchOnDisabled, false);
        assert!(axis.brake.is_down());
        axis.cycle(State::QuickStopActive, false);
        assert!(!axis.brake.is_down());

        // Nothing has led it there.
        let mut axis = Axis::driven();
        axis.cycles(10, State::SwitchOnDisabled);
        assert!(!axis.brake.is_down());
        axis.enables = false;
        axis.cycles(2, State::SwitchOnDisabled);
        assert!(!axis.brake.is_down());
        axis.cycle(State::SwitchOnDisabled, false);
        assert!(axis.brake.is_down());

        // Shown by a single sample, however long ago its drive has got that word.
        let mut axis = Axis::led_down();
        axis.traits.drive_cycle = Duration::ZERO;
        axis.cycles(5, State::QuickStopActive);
        axis.cycle(State::SwitchOnDisabled, false);
        assert!(!axis.brake.is_down());
        axis.cycle(State::SwitchOnDisabled, false);
        assert!(axis.brake.is_down());
    }

    #[test]
    fn an_axis_of_which_nothing_is_known_is_free_when_its_power_is_surely_off() {
        let mut axis = Axis {
            brake: Brake::default(),
            ..Axis::led_down()
        };
        axis.cycles(2, State::SwitchOnDisabled);
        assert!(axis.brake.may_drive());
        axis.cycle(State::SwitchOnDisabled, false);
        assert!(!axis.brake.may_drive());

        // One that was driven runs on.
        let mut axis = Axis::led_down();
        axis.cycles(10, State::SwitchOnDisabled);
        assert!(axis.brake.is_down() && axis.brake.may_drive());
        axis.brake.give_up();
        axis.cycle(State::SwitchOnDisabled, false);
        assert!(!axis.brake.may_drive());
        // Until it has been seen to stand.
        assert!(!axis.brake.is_free());
        axis.cycle(State::SwitchOnDisabled, true);
        axis.cycle(State::SwitchOnDisabled, false);
        assert!(axis.brake.is_free());
    }

    #[test]
    fn an_axis_that_does_not_come_to_rest_is_held_for_its_time() {
        let mut axis = Axis::led_down();
        axis.cycles(20, State::OperationEnabled);
        assert!(axis.brake.holds(false));
        axis.cycle(State::OperationEnabled, false);
        assert!(!axis.brake.holds(false));
        axis.cycle(State::OperationEnabled, false);
        assert!(!axis.brake.holds(false), "it stays over");
        // It stops the axis at last: its time begins anew, once.
        axis.cycles(21, State::QuickStopActive);
        assert!(!axis.brake.holds(false));
        // One that came to rest, or is not to lose its power, has its time again.
        for (standing, leading_down) in [(true, true), (false, false)] {
            axis.leading_down = leading_down;
            axis.cycle(State::QuickStopActive, standing);
            axis.leading_down = true;
            axis.cycles(20, State::QuickStopActive);
            assert!(axis.brake.holds(false), "{standing}, {leading_down}");
            axis.cycle(State::QuickStopActive, false);
            assert!(!axis.brake.holds(false), "{standing}, {leading_down}");
        }
    }

    #[test]
    fn a_quick_stop_that_begins_late_has_its_whole_time() {
        let mut axis = Axis::led_down();
        axis.cycles(25, State::OperationEnabled);
        assert!(!axis.brake.holds(false));
        axis.cycles(20, State::QuickStopActive);
        assert!(axis.brake.holds(false));
        axis.cycle(State::QuickStopActive, false);
        assert!(!axis.brake.holds(false));
    }

    #[test]
    fn the_idle_path_is_for_what_a_sample_like_the_last_one_does_not_change() {
        assert!(!Brake::default().allows_idle_path(true));
        let mut axis = Axis::driven();
        assert!(axis.brake.allows_idle_path(true));
        assert!(!axis.brake.allows_idle_path(false));
        axis.leading_down = true;
        axis.cycle(State::OperationEnabled, false);
        assert!(!axis.brake.allows_idle_path(true), "its time runs");
        let mut axis = Axis::driven();
        axis.cycle(State::SwitchOnDisabled, false);
        assert!(!axis.brake.allows_idle_path(true), "it may be off");
        axis.cycle(State::SwitchOnDisabled, true);
        assert!(!axis.brake.allows_idle_path(true), "not for sure");
        axis.enables = false;
        axis.cycles(3, State::SwitchOnDisabled);
        assert!(axis.brake.allows_idle_path(true) && axis.brake.allows_idle_path(false));
    }
}
