//! The drives that exist, as behaviours, written from their documents; where a document is silent the comment says what
//! is assumed.

use core::time::Duration;

use super::behaviour::{
    AckPolicy, Behaviour, Bit5, FactorChange, FollowingError, FullBuffer, HOMING_METHODS,
    HomeOffset, LimitSwitches, LimitViolation, LimitsOff, ModeZero, ReachedPolicy, RelativeBase,
    WhileHalted, WhileMoving,
};
use super::entries::factor;
use super::machine::Machine;
use super::objects::{
    Access, DataType, Entry, LIMIT_MAX, LIMIT_MIN, MAX_PROFILE_VELOCITY, Mapping, POSITION_DIVISOR,
    POSITION_NUMERATOR, PROFILE_TYPE, START_STOP_SPEED, TARGET_POSITION, VELOCITY_ENCODER_DIVISOR,
    VELOCITY_ENCODER_NUMERATOR,
};

use super::plant::Plant;

use Access::ReadWrite as Rw;
use DataType::{I16, I32, U16, U32};
use Mapping::{None as No, Rx};

/// The drive with 2010h: its page has no word of these objects of profile position mode.
const WITHOUT_2010H: &[u16] = &[
    0x606B, 0x606C, 0x606D, 0x606E, 0x606F, 0x6070, 0x6072, 0x607B, 0x607D, 0x607E, 0x607F, 0x6080,
    0x6082, 0x608F, 0x6091, 0x6092, 0x6096, 0x6097, 0x60B8, 0x60B9, 0x60BA, 0x60BB, 0x60BC, 0x60BD,
    0x60C5, 0x60C6, 0x60D1, 0x60D2, 0x60D3, 0x60D4, 0x60D5, 0x60D6, 0x60D7, 0x60D8, 0x60E0, 0x60E1,
    0x60F2, 0x60FF,
];
const OWN_2010H: &[Entry] = &[
    // UNSIGNED16, rw, mandatory; unit and default are in no document, assumed: counts/s and 0, which is no step.
    Entry::new(START_STOP_SPEED, U16, Rw, Rx, "Min profile velocity"),
];

/// AX2000: the factors and the one torque limit (6072h) of DSP 402 v2 in place of those of v3. Its limits are position registers of its maker's.
const WITHOUT_AX2000: &[u16] = &[
    0x607B, 0x607D, 0x607E, 0x607F, 0x6080, 0x6082, 0x608F, 0x6091, 0x6092, 0x6096, 0x60C5, 0x60C6,
    0x60B8, 0x60B9, 0x60BA, 0x60BB, 0x60BC, 0x60BD, 0x60D1, 0x60D2, 0x60D3, 0x60D4, 0x60D5, 0x60D6,
    0x60D7, 0x60D8, 0x60E0, 0x60E1, 0x60F2,
];
const OWN_AX2000: &[Entry] = &[
    // From −(2³¹ − 1), not −2³¹.
    Entry::new(TARGET_POSITION, I32, Rw, Rx, "target_position").range(-0x7FFF_FFFF, 0x7FFF_FFFF),
    // Unit none, EEPROM yes.
    Entry::new(PROFILE_TYPE, I16, Rw, Rx, "motion_profile_type").saved(),
    Entry::count(0x6093, 2, "position_factor"),
    factor(POSITION_NUMERATOR, "numerator"),
    factor(POSITION_DIVISOR, "feed_constant"),
    Entry::count(0x6094, 2, "velocity_encoder_factor"),
    factor(VELOCITY_ENCODER_NUMERATOR, "numerator"),
    factor(VELOCITY_ENCODER_DIVISOR, "divisor"),
];

/// Sigma-7: the three objects of its page, with their ranges, defaults and what is saved.
const OWN_SIGMA7: &[Entry] = &[
    Entry::new(TARGET_POSITION, I32, Rw, Rx, "Target position"),
    sigma7_limit(LIMIT_MIN, "Min position limit"),
    sigma7_limit(LIMIT_MAX, "Max position limit"),
    Entry::new(MAX_PROFILE_VELOCITY, U32, Rw, Rx, "Max profile velocity")
        .default(0x7FFF_FFFF)
        .saved(),
];

const fn sigma7_limit(address: (u16, u8), name: &'static str) -> Entry {
    Entry::new(address, I32, Rw, No, name)
        .range(-0x2000_0000, 0x1FFF_FFFF)
        .saved()
}

impl Behaviour {
    /// A plain CiA 402 v3 drive with one active and one waiting set-point.
    pub fn generic() -> Behaviour {
        Behaviour {
            period: Duration::from_millis(1),
            start_up_cycles: 1,
            power_on_cycles: 0,
            mode_change_cycles: 0,
            auto_3_4: true,
            transition_16: true,
            bit_7_irrelevant: false,
            ready_needs_voltage: false,
            open_bit_5: false,
            manufacturer_bits: 0,
            ack: AckPolicy::BufferFree,
            bit_5: Bit5::Replaces,
            bit_9: true,
            start_bits_before_edge: false,
            while_moving: WhileMoving::Queues,
            waiting_set_points: 1,
            full_buffer: FullBuffer::Ignore,
            relative_base: RelativeBase::PositioningOption,
            reached: ReachedPolicy::WindowAfterEnd,
            velocity_at_once: false,
            halt_keeps: true,
            while_halted: WhileHalted::Takes,
            edge_at_mode_change: false,
            halt_blocks_mode_change: false,
            motion_blocks_mode_change: false,
            operation_blocks_mode_change: false,
            mode_zero: ModeZero::Clears,
            bit_4_filter_cycles: 0,
            limits_off: LimitsOff::MinNotBelowMax,
            limits_need_reference: false,
            limit_violation: LimitViolation::Clamp,
            following_error: FollowingError::Fault,
            actual_lag_cycles: 0,
            coast_deceleration: 1_000_000,
            limit_deceleration: 100_000_000,
            supported_modes: 0x0000_01AD,
            homing_methods: &HOMING_METHODS,
            homing_method_refused_at_write: false,
            home_offset: HomeOffset::HomeReadsOffset,
            factor_change: FactorChange::Meaning,
            limit_switches: LimitSwitches::Shown,
            plant: Plant::default(),
            machine: Machine::default(),
            profile_types: &[0],
            without: &[],
            own_objects: &[],
            position_range: (i32::MIN, i32::MAX),
            goes_on_at_end_velocity: false,
            quick_stop_option: 2,
            abort_connection_option: 1,
        }
    }

    /// Kollmorgen AKD2G, from its pages on profile position mode and on the controlword.
    pub fn akd2g() -> Behaviour {
        Behaviour {
            // Its example goes from 06h to 0Fh; its command table leaves bit 3 open in "Switch on".
            auto_3_4: true,
            // Not in its command table; after a quick stop one has to step through the state machine.
            transition_16: false,
            // Its command table prints X for bit 7 except at fault reset.
            bit_7_irrelevant: true,
            // Bit 12 stays high as long as bit 4, also after arrival, and turns off with it.
            ack: AckPolicy::FollowsBit4,
            // Undocumented; assumed: the demand position, which at standstill is the previous target.
            relative_base: RelativeBase::Demand,
            // Within AXIS#.SETTLE.P; whether also while still moving is not documented, assumed not.
            reached: ReachedPolicy::WindowAfterEnd,
            halt_keeps: true,
            // Of the first AKD generation: limits 0/0 are off.
            limits_off: LimitsOff::BothZero,
            // Bit 13 comes with fault F6001.
            following_error: FollowingError::Fault,
            // Its mode table: pp, pv, tq, hm, csp, csv; the manufacturer's own modes have no bit here.
            supported_modes: 0x0000_01AD,
            // Undocumented; assumed.
            mode_zero: ModeZero::Keeps,
            ..Behaviour::generic()
        }
    }

    /// The drive with 2010h (minimum profile velocity), from its page on profile position mode.
    pub fn pp2010() -> Behaviour {
        Behaviour {
            // Bit 12 falls when the drive can take a set-point; both busy keeps it high.
            ack: AckPolicy::BufferFree,
            // Bit 5 = 1 is processed at once, also on a full buffer.
            bit_5: Bit5::Replaces,
            // Not described.
            bit_9: false,
            // Up to two set-points; that the one that runs is one of them is inferred.
            waiting_set_points: 1,
            // What a third set-point with bit 5 = 0 does is not described; assumed: it is lost.
            full_buffer: FullBuffer::Ignore,
            // Bit 6 is not described; assumed.
            relative_base: RelativeBase::PreviousTarget,
            // Profile position is described; homing is assumed.
            supported_modes: 0x0000_0021,
            // Only linear ramps, yet 6086h is mandatory; another value is refused as out of range.
            profile_types: &[0],
            without: WITHOUT_2010H,
            own_objects: OWN_2010H,
            ..Behaviour::generic()
        }
    }

    /// Beckhoff AX2000, from its CANopen manual's pages 101 and 102.
    pub fn ax2000() -> Behaviour {
        Behaviour {
            // Page 102: bit 5 = 1 goes on through the target; page 101: only with linear ramps.
            bit_5: Bit5::Blends,
            // Page 101: after arrival the drive says so and then receives a new one. That it waits for bit 4 is assumed.
            while_moving: WhileMoving::TakenAfterArrival,
            // The request and its answer are bits 4, 5 and 12; there is no bit 9.
            bit_9: false,
            ack: AckPolicy::BufferFree,
            // 0 linear, 1 sin²; manufacturer-specific and further types are not supported.
            profile_types: &[0, 1],
            // Its base is chosen by a manufacturer's object; assumed: the demand position.
            relative_base: RelativeBase::Demand,
            // Assumed: pp, pv, hm.
            supported_modes: 0x0000_0025,
            without: WITHOUT_AX2000,
            own_objects: OWN_AX2000,
            ..Behaviour::generic()
        }
    }

    /// Yaskawa Sigma-7, from its page on 607Ah, 607Dh and 607Fh.
    pub fn sigma7() -> Behaviour {
        Behaviour {
            limits_off: LimitsOff::MinNotBelowMax,
            // In force when homing is completed or with an absolute encoder.
            limits_need_reference: true,
            // 607Dh counts from the machine's home position, and a limit is corrected by taking 607Ch off: so does a position.
            home_offset: HomeOffset::ZeroBeyondHome,
            // Targets are compared with the corrected limits; what then happens is not on the page, assumed.
            limit_violation: LimitViolation::Clamp,
            // Assumed: pp, pv, tq, hm, ip, csp, csv, cst.
            supported_modes: 0x0000_03ED,
            own_objects: OWN_SIGMA7,
            ..Behaviour::generic()
        }
    }
}
