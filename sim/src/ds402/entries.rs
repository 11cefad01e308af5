//! The list of drive profile objects from which every drive's own list is made.

use super::objects::{
    ABORT_CONNECTION_OPTION, ACCELERATION_DIVISOR, ACCELERATION_NUMERATOR, Access, CONTROLWORD,
    DIGITAL_INPUTS, DIGITAL_OUTPUT_MASK, DIGITAL_OUTPUTS, DISABLE_OPERATION_OPTION, DataType,
    ENCODER_INCREMENTS, ENCODER_REVOLUTIONS, END_VELOCITY, ERROR_CODE, Entry,
    FAULT_REACTION_OPTION, FEED, FEED_SHAFT, FOLLOWING_ERROR_ACTUAL, FOLLOWING_TIMEOUT,
    FOLLOWING_WINDOW, GEAR_MOTOR, GEAR_SHAFT, HALT_OPTION, HOME_OFFSET, HOMING_ACCELERATION,
    HOMING_METHOD, HOMING_SPEED_SWITCH, HOMING_SPEED_ZERO, LIMIT_MAX, LIMIT_MIN, MAX_ACCELERATION,
    MAX_DECELERATION, MAX_MOTOR_SPEED, MAX_PROFILE_VELOCITY, MAX_TORQUE, MODE, MODE_DISPLAY,
    Mapping, NEGATIVE_TORQUE_LIMIT, POLARITY, POSITION_ACTUAL, POSITION_DEMAND, POSITION_INTERNAL,
    POSITION_WINDOW, POSITION_WINDOW_TIME, POSITIONING_OPTION, POSITIVE_TORQUE_LIMIT,
    PROFILE_ACCELERATION, PROFILE_DECELERATION, PROFILE_TYPE, PROFILE_VELOCITY,
    QUICK_STOP_DECELERATION, QUICK_STOP_OPTION, RANGE_MAX, RANGE_MIN, SHUTDOWN_OPTION, STATUSWORD,
    SUPPORTED_MODES, TARGET_POSITION, TARGET_VELOCITY, TORQUE_ACTUAL, TOUCH_PROBE_FUNCTION,
    TOUCH_PROBE_STATUS, VELOCITY_ACTUAL, VELOCITY_DEMAND, VELOCITY_DIVISOR, VELOCITY_NUMERATOR,
    VELOCITY_THRESHOLD, VELOCITY_THRESHOLD_TIME, VELOCITY_WINDOW, VELOCITY_WINDOW_TIME,
};

use Access::{ReadOnly as Ro, ReadWrite as Rw};
use DataType::{I8, I16, I32, U8, U16, U32};
use Mapping::{Both, None as No, Rx, Tx};

/// One turn of the assumed encoder, in counts.
pub(super) const TURN: i64 = 1 << 20;

/// Torque limits at power-up, in thousandths of the rated torque. CiA 402 leaves them to the maker; three times the rated
/// torque is a usual peak of a servo.
const PEAK_TORQUE: i64 = 3_000;

/// One number of a factor: never 0.
pub(super) const fn factor(address: (u16, u8), name: &'static str) -> Entry {
    Entry::new(address, U32, Rw, No, name)
        .default(1)
        .range(1, 0xFFFF_FFFF)
}

/// What a touch probe has found.
const fn probed(index: u16, kind: DataType, name: &'static str) -> Entry {
    Entry::new((index, 0), kind, Ro, Tx, name)
}

/// All entries, by index and subindex. Where DSP 402 v2 names a default or a range it is taken; ramps and velocities are
/// one turn per second and more, so that a drive that nobody configured still moves. 605Ah is mappable because the
/// AKD2G lists it among its PDO data.
pub(super) static ENTRIES: &[Entry] = &[
    Entry::new(
        ABORT_CONNECTION_OPTION,
        I16,
        Rw,
        Rx,
        "Abort connection option code",
    )
    .range(0, 3),
    Entry::new(ERROR_CODE, U16, Ro, Tx, "Error code"),
    Entry::new(CONTROLWORD, U16, Rw, Rx, "Controlword"),
    Entry::new(STATUSWORD, U16, Ro, Tx, "Statusword"),
    Entry::new(QUICK_STOP_OPTION, I16, Rw, Both, "Quick stop option code")
        .default(2)
        .range(0, 8),
    Entry::new(SHUTDOWN_OPTION, I16, Rw, No, "Shutdown option code").range(0, 1),
    Entry::new(
        DISABLE_OPERATION_OPTION,
        I16,
        Rw,
        No,
        "Disable operation option code",
    )
    .default(1)
    .range(0, 1),
    Entry::new(HALT_OPTION, I16, Rw, No, "Halt option code")
        .default(1)
        .range(0, 4),
    Entry::new(
        FAULT_REACTION_OPTION,
        I16,
        Rw,
        No,
        "Fault reaction option code",
    )
    .default(2)
    .range(0, 4),
    Entry::new(MODE, I8, Rw, Rx, "Modes of operation"),
    Entry::new(MODE_DISPLAY, I8, Ro, Tx, "Modes of operation display"),
    Entry::new(POSITION_DEMAND, I32, Ro, Tx, "Position demand value"),
    Entry::new(
        POSITION_INTERNAL,
        I32,
        Ro,
        Tx,
        "Position actual internal value",
    ),
    Entry::new(POSITION_ACTUAL, I32, Ro, Tx, "Position actual value"),
    Entry::new(FOLLOWING_WINDOW, U32, Rw, Rx, "Following error window").default(TURN),
    Entry::new(FOLLOWING_TIMEOUT, U16, Rw, Rx, "Following error time out").default(10),
    Entry::new(POSITION_WINDOW, U32, Rw, Rx, "Position window").default(10),
    Entry::new(POSITION_WINDOW_TIME, U16, Rw, Rx, "Position window time"),
    Entry::new(VELOCITY_DEMAND, I32, Ro, Tx, "Velocity demand value"),
    Entry::new(VELOCITY_ACTUAL, I32, Ro, Tx, "Velocity actual value"),
    Entry::new(VELOCITY_WINDOW, U16, Rw, Rx, "Velocity window").default(1_000),
    Entry::new(VELOCITY_WINDOW_TIME, U16, Rw, Rx, "Velocity window time").default(10),
    Entry::new(VELOCITY_THRESHOLD, U16, Rw, Rx, "Velocity threshold").default(1_000),
    Entry::new(
        VELOCITY_THRESHOLD_TIME,
        U16,
        Rw,
        Rx,
        "Velocity threshold time",
    ),
    Entry::new(MAX_TORQUE, U16, Rw, Rx, "Max torque").default(PEAK_TORQUE),
    Entry::new(TORQUE_ACTUAL, I16, Ro, Tx, "Torque actual value"),
    Entry::new(TARGET_POSITION, I32, Rw, Rx, "Target position"),
    Entry::count(0x607B, 2, "Position range limit"),
    Entry::new(RANGE_MIN, I32, Rw, Rx, "Min position range limit").default(-0x8000_0000),
    Entry::new(RANGE_MAX, I32, Rw, Rx, "Max position range limit").default(0x7FFF_FFFF),
    Entry::new(HOME_OFFSET, I32, Rw, Rx, "Home offset"),
    Entry::count(0x607D, 2, "Software position limit"),
    Entry::new(LIMIT_MIN, I32, Rw, Rx, "Min position limit"),
    Entry::new(LIMIT_MAX, I32, Rw, Rx, "Max position limit"),
    Entry::new(POLARITY, U8, Rw, Rx, "Polarity"),
    Entry::new(MAX_PROFILE_VELOCITY, U32, Rw, Rx, "Max profile velocity").default(0xFFFF_FFFF),
    Entry::new(MAX_MOTOR_SPEED, U32, Rw, Rx, "Max motor speed").default(0xFFFF_FFFF),
    Entry::new(PROFILE_VELOCITY, U32, Rw, Rx, "Profile velocity").default(TURN),
    Entry::new(END_VELOCITY, U32, Rw, Rx, "End velocity"),
    Entry::new(PROFILE_ACCELERATION, U32, Rw, Rx, "Profile acceleration").default(10 * TURN),
    Entry::new(PROFILE_DECELERATION, U32, Rw, Rx, "Profile deceleration").default(10 * TURN),
    Entry::new(
        QUICK_STOP_DECELERATION,
        U32,
        Rw,
        Rx,
        "Quick stop deceleration",
    )
    .default(20 * TURN),
    Entry::new(PROFILE_TYPE, I16, Rw, Rx, "Motion profile type"),
    Entry::count(0x608F, 2, "Position encoder resolution"),
    Entry::new(ENCODER_INCREMENTS, U32, Rw, No, "Encoder increments")
        .default(TURN)
        .range(1, 0xFFFF_FFFF),
    factor(ENCODER_REVOLUTIONS, "Motor revolutions"),
    Entry::count(0x6091, 2, "Gear ratio"),
    factor(GEAR_MOTOR, "Motor revolutions"),
    factor(GEAR_SHAFT, "Shaft revolutions"),
    Entry::count(0x6092, 2, "Feed constant"),
    Entry::new(FEED, U32, Rw, No, "Feed")
        .default(TURN)
        .range(1, 0xFFFF_FFFF),
    factor(FEED_SHAFT, "Shaft revolutions"),
    Entry::count(0x6096, 2, "Velocity factor"),
    factor(VELOCITY_NUMERATOR, "Numerator"),
    factor(VELOCITY_DIVISOR, "Divisor"),
    Entry::count(0x6097, 2, "Acceleration factor"),
    factor(ACCELERATION_NUMERATOR, "Numerator"),
    factor(ACCELERATION_DIVISOR, "Divisor"),
    Entry::new(HOMING_METHOD, I8, Rw, Rx, "Homing method"),
    Entry::count(0x6099, 2, "Homing speeds"),
    Entry::new(
        HOMING_SPEED_SWITCH,
        U32,
        Rw,
        Rx,
        "Speed during search for switch",
    )
    .default(TURN),
    Entry::new(
        HOMING_SPEED_ZERO,
        U32,
        Rw,
        Rx,
        "Speed during search for zero",
    )
    .default(TURN / 10),
    Entry::new(HOMING_ACCELERATION, U32, Rw, Rx, "Homing acceleration").default(10 * TURN),
    Entry::new(TOUCH_PROBE_FUNCTION, U16, Rw, Rx, "Touch probe function"),
    Entry::new(TOUCH_PROBE_STATUS, U16, Ro, Tx, "Touch probe status"),
    probed(0x60BA, I32, "Touch probe 1 positive edge"),
    probed(0x60BB, I32, "Touch probe 1 negative edge"),
    probed(0x60BC, I32, "Touch probe 2 positive edge"),
    probed(0x60BD, I32, "Touch probe 2 negative edge"),
    Entry::new(MAX_ACCELERATION, U32, Rw, Rx, "Max acceleration").default(0xFFFF_FFFF),
    Entry::new(MAX_DECELERATION, U32, Rw, Rx, "Max deceleration").default(0xFFFF_FFFF),
    probed(0x60D1, U32, "Touch probe time stamp 1 positive value"),
    probed(0x60D2, U32, "Touch probe time stamp 1 negative value"),
    probed(0x60D3, U32, "Touch probe time stamp 2 positive value"),
    probed(0x60D4, U32, "Touch probe time stamp 2 negative value"),
    probed(0x60D5, U16, "Touch probe 1 positive edge counter"),
    probed(0x60D6, U16, "Touch probe 1 negative edge counter"),
    probed(0x60D7, U16, "Touch probe 2 positive edge counter"),
    probed(0x60D8, U16, "Touch probe 2 negative edge counter"),
    Entry::new(POSITIVE_TORQUE_LIMIT, U16, Rw, Rx, "Positive torque limit").default(PEAK_TORQUE),
    Entry::new(NEGATIVE_TORQUE_LIMIT, U16, Rw, Rx, "Negative torque limit").default(PEAK_TORQUE),
    Entry::new(POSITIONING_OPTION, U16, Rw, Rx, "Positioning option code"),
    Entry::new(
        FOLLOWING_ERROR_ACTUAL,
        I32,
        Ro,
        Tx,
        "Following error actual value",
    ),
    Entry::new(DIGITAL_INPUTS, U32, Ro, Tx, "Digital inputs"),
    Entry::count(0x60FE, 2, "Digital outputs"),
    Entry::new(DIGITAL_OUTPUTS, U32, Rw, Rx, "Physical outputs"),
    Entry::new(DIGITAL_OUTPUT_MASK, U32, Rw, Rx, "Bit mask"),
    Entry::new(TARGET_VELOCITY, I32, Rw, Rx, "Target velocity"),
    Entry::new(SUPPORTED_MODES, U32, Ro, Tx, "Supported drive modes"),
];
