//! How a drive's Profile Position mode differs from other drives', as data.

use core::time::Duration;

use crate::coe::ObjectAddress;

use super::{BufferMode, Failure, LimitsRule, Unsupported};

/// Motion profile type 6086h of linear ramps.
const LINEAR: i16 = 0;

/// The bits that one kind of start takes, or why the drive has no such start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum StartBits {
    /// By the drive's buffer, with these bits. No others of the controlword can be asked for.
    Bits {
        /// Bit 5, change set immediately.
        change_set_immediately: bool,
        /// Bit 9, change on set-point.
        change_on_set_point: bool,
    },
    /// Not by the drive's buffer: sequenced by this library after the active move's arrival.
    Sequenced,
    /// The drive cannot do it, for this reason.
    Unsupported(&'static str),
}

/// Whether bit 12 shows that the drive's set-point buffer is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum BufferSignal {
    /// Bit 12 stays 1 while no set-point can be taken, and falls when the active one ends.
    Acknowledge,
    /// Bit 12 follows bit 4 and shows nothing of the buffer. This library counts set-points. A bit 12 that is still high belongs to
    /// the handshake before.
    None,
    /// The drive's documents do not say. This library counts set-points. A bit 12 that stays high while two are held may be that of
    /// a full buffer.
    Unknown,
}

/// What a relative move counts from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum RelativeBase {
    /// The previous target.
    PreviousTarget,
    /// The position demand value, which at rest is the previous target.
    Demand,
    /// The position actual value.
    Actual,
    /// What the drive's positioning option code 60F2h says, which a `Network` reads when the axis attaches; until it is
    /// known as `Undocumented`.
    PositioningOption,
    /// The drive's documents do not say: the end of a relative move is not compared with the position.
    Undocumented,
}

impl RelativeBase {
    /// What positioning option code 60F2h says in its bits 0 and 1.
    ///
    /// ```
    /// use servocrab::profile_position::RelativeBase;
    /// assert_eq!(RelativeBase::of_positioning_option(0x0001), RelativeBase::Demand);
    /// ```
    #[must_use]
    pub const fn of_positioning_option(code: u16) -> Self {
        match code & 0b11 {
            0b00 => Self::PreviousTarget,
            0b01 => Self::Demand,
            0b10 => Self::Actual,
            _ => Self::Undocumented,
        }
    }
}

/// Where a drive shows whether an axis has been homed and has kept its position since: bits of a 32-bit object.
///
/// ```
/// use servocrab::drives;
/// let shown = drives::akd2g().traits.homed.ok_or("it shows nothing")?;
/// assert!(shown.is_homed(0b0_0110)); // home position found, homing done
/// assert!(!shown.is_homed(0b1_0110)); // and a homing error since
/// # Ok::<(), &str>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HomedSignal {
    /// The object of axis 1.
    pub object: ObjectAddress,
    /// All of these bits are 1 of an axis that is homed.
    pub set: u32,
    /// All of these bits are 0 of an axis that is homed.
    pub clear: u32,
}

impl HomedSignal {
    /// Whether the object's value says that the axis is homed.
    #[must_use]
    pub const fn is_homed(&self, value: u32) -> bool {
        self.set != 0 && value & self.set == self.set && value & self.clear == 0
    }
}

/// How a drive's Profile Position mode behaves.
///
/// ```
/// use servocrab::{BufferMode, profile_position::{BufferSignal, StartBits, Traits}};
/// let traits = Traits::cia402();
/// assert!(matches!(traits.bits(BufferMode::Blending), StartBits::Bits { .. }));
/// assert_eq!(traits.buffer_signal, BufferSignal::Unknown);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Traits {
    /// Bits of [`BufferMode::Aborting`].
    pub immediately: StartBits,
    /// Bits of [`BufferMode::Buffered`].
    pub after_current: StartBits,
    /// Bits of [`BufferMode::Blending`].
    pub blend: StartBits,
    /// Whether bits 5, 6 and 9 go out before bit 4 rises, until the drive has surely seen them: for a drive that takes them from the
    /// word before. Else they go out with bit 4, as CiA 402 has it, and a move on an axis that is ready rises in the next frame.
    /// With it a move whose bits 5, 6 and 9 are not all 0 rises two of the drive's cycles later, unless it waits for its turn that long.
    pub start_bits_first: bool,
    /// What bit 12 shows of the buffer.
    pub buffer_signal: BufferSignal,
    /// What relative moves count from.
    pub relative_base: RelativeBase,
    /// Whether a halted set-point is kept and continued when bit 8 falls.
    pub halt_keeps_set_point: bool,
    /// Whether it acknowledges a set-point while bit 8 is high, and goes there when bit 8 falls. False where its documents do not say: then
    /// none is sent to a halted axis.
    pub acknowledges_while_halted: bool,
    /// Whether a change of profile velocity 6081h changes the speed of the move under way. False where its documents do not say.
    pub takes_velocity_at_once: bool,
    /// The drive's own cycle: bit 4 must stay low for two of them where nothing shows that the drive has seen it low. With distributed
    /// clocks a `Network` takes SYNC0's cycle where that is longer.
    pub drive_cycle: Duration,
    /// Whether bit 4 of the statusword shows that the power stage has its supply.
    pub shows_voltage: bool,
    /// Where the drive shows that an axis is homed; none where its documents do not say. A `Network` reads it when the axis attaches
    /// ([`CoreConfig::homed`](crate::axis::CoreConfig::homed)).
    pub homed: Option<HomedSignal>,
    /// The motion profile types 6086h that the drive has; empty where its documents do not say: then all are sent.
    pub profile_types: &'static [i16],
    /// Whether a target is passed without stopping only with linear ramps (6086h = 0), on both sides of it.
    pub blend_needs_linear_ramps: bool,
    /// How it counts its software position limits 607Dh.
    pub limits: LimitsRule,
}

impl Traits {
    /// A drive after CiA 402 version 3, of whose bit 12 it is not known whether it shows a full buffer.
    #[must_use]
    pub const fn cia402() -> Self {
        Self {
            immediately: StartBits::Bits {
                change_set_immediately: true,
                change_on_set_point: false,
            },
            after_current: StartBits::Bits {
                change_set_immediately: false,
                change_on_set_point: false,
            },
            blend: StartBits::Bits {
                change_set_immediately: false,
                change_on_set_point: true,
            },
            start_bits_first: false,
            buffer_signal: BufferSignal::Unknown,
            relative_base: RelativeBase::Undocumented,
            halt_keeps_set_point: true,
            acknowledges_while_halted: false,
            takes_velocity_at_once: false,
            drive_cycle: Duration::from_millis(1),
            shows_voltage: false,
            homed: None,
            profile_types: &[],
            blend_needs_linear_ramps: false,
            limits: LimitsRule::cia402(),
        }
    }

    /// The time after which the drive has surely seen a delivered word: two of its own cycles.
    #[must_use]
    pub const fn surely_seen(&self) -> Duration {
        self.drive_cycle.saturating_mul(2)
    }

    /// The bits that a kind of start takes on this drive.
    #[must_use]
    pub const fn bits(&self, buffer_mode: BufferMode) -> StartBits {
        match buffer_mode {
            BufferMode::Aborting => self.immediately,
            BufferMode::Buffered => self.after_current,
            BufferMode::Blending => self.blend,
        }
    }

    /// Whether a move that is started this way needs linear ramps, its own and those of the move before.
    pub(crate) fn needs_linear_ramps(&self, buffer_mode: BufferMode) -> bool {
        buffer_mode == BufferMode::Blending && self.blend_needs_linear_ramps
    }

    /// Whether an axis with this drive can be held where it is halted.
    ///
    /// # Errors
    /// [`Unsupported::Hold`].
    pub(crate) const fn check_hold(&self, is_modulo: bool) -> Result<(), Failure> {
        let reason = if !self.acknowledges_while_halted {
            "its drive is not known to take a set-point while it is halted"
        } else if let StartBits::Unsupported(reason) = self.immediately {
            reason
        } else if is_modulo {
            "on a modulo axis a set-point to where it stands may lead round a turn"
        } else {
            return Ok(());
        };
        Err(Failure::Unsupported(Unsupported::Hold { reason }))
    }

    /// Whether the drive can start a move with this profile type, this way, after a set-point with that type.
    ///
    /// # Errors
    /// [`Unsupported::ProfileType`].
    pub(crate) fn check_profile_type(
        &self,
        buffer_mode: BufferMode,
        profile_type: Option<i16>,
        before: Option<i16>,
    ) -> Result<(), Failure> {
        let refuse = |profile_type, reason| {
            Err(Failure::Unsupported(Unsupported::ProfileType {
                profile_type,
                reason,
            }))
        };
        if let Some(asked) = profile_type
            && !self.profile_types.is_empty()
            && !self.profile_types.contains(&asked)
        {
            return refuse(asked, "the drive has no such profile type");
        }
        if self.needs_linear_ramps(buffer_mode) {
            if let Some(asked) = profile_type.filter(|&asked| asked != LINEAR) {
                return refuse(asked, "this drive passes a target only with linear ramps");
            }
            if let Some(before) = before.filter(|&before| before != LINEAR) {
                return refuse(
                    before,
                    "this drive passes a target only with linear ramps, and the move before has others",
                );
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_two_bits_of_60f2h_say_what_a_distance_counts_from() {
        use RelativeBase::{Actual, Demand, PreviousTarget, Undocumented};
        for high in [0, 0b100, 0xFFFC] {
            let bases = [0, 1, 2, 3].map(|low| RelativeBase::of_positioning_option(high | low));
            assert_eq!(bases, [PreviousTarget, Demand, Actual, Undocumented]);
        }
    }

    #[test]
    fn an_axis_is_homed_with_all_of_its_bits_high_and_all_others_low() {
        let shown = |set, clear| HomedSignal {
            object: ObjectAddress::new(0x1234, 0),
            set,
            clear,
        };
        let signal = shown(0b0110, 0b1000);
        for (value, homed) in [
            (0b0110, true),
            (0b0111, true),
            (0b0010, false),
            (0b0100, false),
            (0b0001, false),
            (0b1110, false),
            (0, false),
        ] {
            assert_eq!(signal.is_homed(value), homed, "{value:#06b}");
        }
        assert!(!shown(0, 0b1000).is_homed(0), "no bit says so");
    }

    #[test]
    fn a_profile_type_is_refused_that_the_drive_has_not_or_does_not_blend_with() {
        let traits = Traits {
            profile_types: &[0, 1],
            blend_needs_linear_ramps: true,
            ..Traits::cia402()
        };
        let check = |traits: &Traits, buffer_mode, asked, before| match traits.check_profile_type(
            buffer_mode,
            asked,
            before,
        ) {
            Ok(()) => None,
            Err(Failure::Unsupported(Unsupported::ProfileType { profile_type, .. })) => {
                Some(profile_type)
            }
            Err(other) => panic!("{other:?}"),
        };
        use BufferMode::{Blending, Buffered};
        assert_eq!(check(&traits, Buffered, Some(1), Some(1)), None);
        assert_eq!(check(&traits, Buffered, Some(2), None), Some(2));
        assert_eq!(check(&traits, Buffered, None, None), None);
        assert_eq!(check(&traits, Blending, Some(0), Some(0)), None);
        assert_eq!(check(&traits, Blending, Some(1), Some(0)), Some(1));
        assert_eq!(check(&traits, Blending, Some(0), Some(1)), Some(1));
        assert_eq!(check(&traits, Blending, None, Some(1)), Some(1));
        assert_eq!(check(&traits, Blending, None, None), None);
        let of_all = Traits {
            profile_types: &[],
            blend_needs_linear_ramps: false,
            ..traits
        };
        assert_eq!(check(&of_all, Buffered, Some(2), None), None);
        assert_eq!(check(&of_all, Blending, Some(1), Some(1)), None);
    }
}
