//! How a drive's Profile Position mode differs from other drives', as data.

use core::time::Duration;

use crate::ds402::Controlword;

use super::{Failure, LimitsRule, Start};

/// Motion profile type 6086h of linear ramps.
const LINEAR: i16 = 0;

/// The bits that one kind of start takes, or why the drive has no such start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StartBits {
    /// These of bits 5 and 9.
    Bits(Controlword),
    /// Not by the drive's buffer: sequenced by this library after the active move's arrival.
    Sequenced,
    /// The drive cannot do it, for this reason.
    Unsupported(&'static str),
}

/// Whether bit 12 shows that the drive's set-point buffer is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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
    /// The drive's documents do not say; relative moves are not checked against the position.
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

/// How a drive's Profile Position mode behaves.
///
/// ```
/// use servocrab::profile_position::{BufferSignal, StartBits, Start, Traits};
/// let traits = Traits::cia402();
/// assert!(matches!(traits.bits(Start::Blend), StartBits::Bits(_)));
/// assert_eq!(traits.buffer_signal, BufferSignal::Unknown);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Traits {
    /// Bits of [`Start::Immediately`].
    pub immediately: StartBits,
    /// Bits of [`Start::AfterCurrent`].
    pub after_current: StartBits,
    /// Bits of [`Start::Blend`].
    pub blend: StartBits,
    /// What bit 12 shows of the buffer.
    pub buffer_signal: BufferSignal,
    /// What relative moves count from.
    pub relative_base: RelativeBase,
    /// Whether a halted set-point is kept and continued when bit 8 falls.
    pub halt_keeps_set_point: bool,
    /// The drive's own cycle: bit 4 must stay low for two of them where nothing shows that the drive has seen it low. With distributed
    /// clocks a `Network` takes SYNC0's cycle where that is longer.
    pub drive_cycle: Duration,
    /// Whether bit 4 of the statusword shows that the power stage has its supply.
    pub shows_voltage: bool,
    /// The motion profile types 6086h that the drive has; empty where its documents do not say: then all are sent.
    pub profile_types: &'static [i16],
    /// Whether a target is passed without stopping only with linear ramps (6086h = 0), on both sides of it.
    pub blend_needs_linear_ramps: bool,
    /// How it counts its software position limits 607Dh.
    pub limits: LimitsRule,
    /// Whether the drive's documents give the velocity threshold 606Fh in the unit of 606Ch. Then a `Network` reads it as
    /// [`Tolerances::velocity`](crate::axis::Tolerances::velocity) when the axis attaches.
    pub threshold_in_velocity_units: bool,
}

impl Traits {
    /// A drive after CiA 402 version 3, of whose bit 12 it is not known whether it shows a full buffer.
    #[must_use]
    pub const fn cia402() -> Self {
        Self {
            immediately: StartBits::Bits(Controlword::CHANGE_IMMEDIATELY),
            after_current: StartBits::Bits(Controlword::empty()),
            blend: StartBits::Bits(Controlword::BLEND),
            buffer_signal: BufferSignal::Unknown,
            relative_base: RelativeBase::Undocumented,
            halt_keeps_set_point: true,
            drive_cycle: Duration::from_millis(1),
            shows_voltage: false,
            profile_types: &[],
            blend_needs_linear_ramps: false,
            limits: LimitsRule::cia402(),
            threshold_in_velocity_units: false,
        }
    }

    /// The time after which the drive has surely seen a delivered word: two of its own cycles.
    #[must_use]
    pub const fn surely_seen(&self) -> Duration {
        self.drive_cycle.saturating_mul(2)
    }

    /// The bits that a kind of start takes on this drive.
    #[must_use]
    pub const fn bits(&self, start: Start) -> StartBits {
        match start {
            Start::Immediately => self.immediately,
            Start::AfterCurrent => self.after_current,
            Start::Blend => self.blend,
        }
    }

    /// Whether the drive can start a move with this profile type, this way, after a set-point with that type.
    ///
    /// # Errors
    /// [`Failure::ProfileType`].
    pub(crate) fn check_profile_type(
        &self,
        start: Start,
        profile_type: Option<i16>,
        before: Option<i16>,
    ) -> Result<(), Failure> {
        let refuse = |profile_type, reason| {
            Err(Failure::ProfileType {
                profile_type,
                reason,
            })
        };
        if let Some(asked) = profile_type
            && !self.profile_types.is_empty()
            && !self.profile_types.contains(&asked)
        {
            return refuse(asked, "the drive has no such profile type");
        }
        if start == Start::Blend && self.blend_needs_linear_ramps {
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
