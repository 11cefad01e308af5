//! The objects that the library knows: the communication area, the drive profile, and those that the source
//! documents name. Widths and access are those of CiA 402, IEC 61800-7-201 and the drives' documents.

use alloc::vec::Vec;

use super::object::{Mappable, Object, ObjectUnit};
use super::value::{ReadOnly, ReadWrite};

const RX: Mappable = Mappable::OUTPUTS;
const TX: Mappable = Mappable::INPUTS;

macro_rules! objects {
    ($($constant:ident, $index:literal : $subindex:literal, $ty:ty, $access:ident, $mappable:expr, $unit:ident, $name:literal;)+) => {
        $(
            #[doc = concat!(stringify!($index), ":", stringify!($subindex), ", ", $name, ".")]
            pub const $constant: Object<$ty, $access> = Object::new($index, $subindex, $name)
                .mappable($mappable)
                .unit(ObjectUnit::$unit);
        )+

        /// All objects of this list, in ascending order of index and subindex.
        #[must_use]
        pub fn all() -> Vec<super::object::AnyObject> {
            alloc::vec![$($constant.into()),+]
        }
    };
}

const NO: Mappable = Mappable::NO;

objects! {
    DEVICE_TYPE, 0x1000:0, u32, ReadOnly, NO, None, "device type";
    ERROR_REGISTER, 0x1001:0, u8, ReadOnly, TX, None, "error register";
    ERROR_HISTORY_COUNT, 0x1003:0, u8, ReadWrite, NO, None, "error history: number of errors";
    ERROR_HISTORY_NEWEST, 0x1003:1, u32, ReadOnly, NO, None, "error history: newest error";
    DEVICE_NAME, 0x1008:0, Vec<u8>, ReadOnly, NO, None, "manufacturer device name";
    HARDWARE_VERSION, 0x1009:0, Vec<u8>, ReadOnly, NO, None, "manufacturer hardware version";
    SOFTWARE_VERSION, 0x100A:0, Vec<u8>, ReadOnly, NO, None, "manufacturer software version";
    VENDOR_ID, 0x1018:1, u32, ReadOnly, NO, None, "vendor ID";
    PRODUCT_CODE, 0x1018:2, u32, ReadOnly, NO, None, "product code";
    REVISION_NUMBER, 0x1018:3, u32, ReadOnly, NO, None, "revision number";
    SERIAL_NUMBER, 0x1018:4, u32, ReadOnly, NO, None, "serial number";
    LOCAL_ERROR_REACTION, 0x10F1:1, u32, ReadWrite, NO, None, "local error reaction";
    SYNC_ERROR_COUNTER_LIMIT, 0x10F1:2, u16, ReadWrite, NO, None, "sync error counter limit";
    SYNC_MANAGER_COUNT, 0x1C00:0, u8, ReadOnly, NO, None, "number of sync managers";
    OUTPUT_ASSIGNMENT_COUNT, 0x1C12:0, u8, ReadWrite, NO, None, "RxPDO assignment: number of PDOs";
    INPUT_ASSIGNMENT_COUNT, 0x1C13:0, u8, ReadWrite, NO, None, "TxPDO assignment: number of PDOs";
    OUTPUT_SYNC_TYPE, 0x1C32:1, u16, ReadWrite, NO, None, "outputs: synchronization type";
    OUTPUT_CYCLE_TIME, 0x1C32:2, u32, ReadWrite, NO, Nanoseconds, "outputs: cycle time";
    OUTPUT_SHIFT_TIME, 0x1C32:3, u32, ReadWrite, NO, Nanoseconds, "outputs: shift time";
    OUTPUT_SYNC_TYPES_SUPPORTED, 0x1C32:4, u16, ReadOnly, NO, None, "outputs: synchronization types supported";
    INPUT_SYNC_TYPE, 0x1C33:1, u16, ReadWrite, NO, None, "inputs: synchronization type";
    INPUT_CYCLE_TIME, 0x1C33:2, u32, ReadWrite, NO, Nanoseconds, "inputs: cycle time";
    INPUT_SHIFT_TIME, 0x1C33:3, u32, ReadWrite, NO, Nanoseconds, "inputs: shift time";
    INPUT_SYNC_TYPES_SUPPORTED, 0x1C33:4, u16, ReadOnly, NO, None, "inputs: synchronization types supported";
    MIN_PROFILE_VELOCITY, 0x2010:0, u16, ReadWrite, NO, Velocity, "min profile velocity";
    AKD2G_MOTION_STATUS, 0x5000:4, u32, ReadOnly, TX, None, "AXIS#.MOTIONSTAT";
    ABORT_CONNECTION_OPTION, 0x6007:0, i16, ReadWrite, RX, None, "abort connection option code";
    ERROR_CODE, 0x603F:0, u16, ReadOnly, TX, None, "error code";
    CONTROLWORD, 0x6040:0, u16, ReadWrite, RX, None, "controlword";
    STATUSWORD, 0x6041:0, u16, ReadOnly, TX, None, "statusword";
    // AKD2G lists 605Ah among the data of its PDOs that the master reads; CiA 402 v2.0 does not map it.
    QUICK_STOP_OPTION, 0x605A:0, i16, ReadWrite, TX, None, "quick stop option code";
    SHUTDOWN_OPTION, 0x605B:0, i16, ReadWrite, NO, None, "shutdown option code";
    DISABLE_OPERATION_OPTION, 0x605C:0, i16, ReadWrite, NO, None, "disable operation option code";
    HALT_OPTION, 0x605D:0, i16, ReadWrite, NO, None, "halt option code";
    FAULT_REACTION_OPTION, 0x605E:0, i16, ReadWrite, NO, None, "fault reaction option code";
    MODE_OF_OPERATION, 0x6060:0, i8, ReadWrite, RX, None, "modes of operation";
    MODE_OF_OPERATION_DISPLAY, 0x6061:0, i8, ReadOnly, TX, None, "modes of operation display";
    POSITION_DEMAND, 0x6062:0, i32, ReadOnly, TX, Position, "position demand value";
    POSITION_ACTUAL_INTERNAL, 0x6063:0, i32, ReadOnly, TX, Increments, "position actual internal value";
    POSITION_ACTUAL, 0x6064:0, i32, ReadOnly, TX, Position, "position actual value";
    FOLLOWING_ERROR_WINDOW, 0x6065:0, u32, ReadWrite, RX, Position, "following error window";
    FOLLOWING_ERROR_TIME_OUT, 0x6066:0, u16, ReadWrite, RX, Milliseconds, "following error time out";
    POSITION_WINDOW, 0x6067:0, u32, ReadWrite, RX, Position, "position window";
    POSITION_WINDOW_TIME, 0x6068:0, u16, ReadWrite, RX, Milliseconds, "position window time";
    VELOCITY_DEMAND, 0x606B:0, i32, ReadOnly, TX, Velocity, "velocity demand value";
    VELOCITY_ACTUAL, 0x606C:0, i32, ReadOnly, TX, Velocity, "velocity actual value";
    VELOCITY_WINDOW, 0x606D:0, u16, ReadWrite, RX, Velocity, "velocity window";
    VELOCITY_WINDOW_TIME, 0x606E:0, u16, ReadWrite, RX, Milliseconds, "velocity window time";
    VELOCITY_THRESHOLD, 0x606F:0, u16, ReadWrite, RX, Velocity, "velocity threshold";
    VELOCITY_THRESHOLD_TIME, 0x6070:0, u16, ReadWrite, RX, Milliseconds, "velocity threshold time";
    TARGET_TORQUE, 0x6071:0, i16, ReadWrite, RX, ThousandthsOfRatedTorque, "target torque";
    MAX_TORQUE, 0x6072:0, u16, ReadWrite, RX, ThousandthsOfRatedTorque, "max torque";
    MAX_CURRENT, 0x6073:0, u16, ReadWrite, RX, ThousandthsOfRatedCurrent, "max current";
    TORQUE_DEMAND, 0x6074:0, i16, ReadOnly, TX, ThousandthsOfRatedTorque, "torque demand";
    MOTOR_RATED_CURRENT, 0x6075:0, u32, ReadWrite, NO, Milliamperes, "motor rated current";
    MOTOR_RATED_TORQUE, 0x6076:0, u32, ReadWrite, NO, MillinewtonMetres, "motor rated torque";
    TORQUE_ACTUAL, 0x6077:0, i16, ReadOnly, TX, ThousandthsOfRatedTorque, "torque actual value";
    CURRENT_ACTUAL, 0x6078:0, i16, ReadOnly, TX, ThousandthsOfRatedCurrent, "current actual value";
    DC_LINK_VOLTAGE, 0x6079:0, u32, ReadOnly, TX, Millivolts, "DC link circuit voltage";
    TARGET_POSITION, 0x607A:0, i32, ReadWrite, RX, Position, "target position";
    POSITION_RANGE_MIN, 0x607B:1, i32, ReadWrite, RX, Position, "position range limit: minimum";
    POSITION_RANGE_MAX, 0x607B:2, i32, ReadWrite, RX, Position, "position range limit: maximum";
    HOME_OFFSET, 0x607C:0, i32, ReadWrite, RX, Position, "home offset";
    // CiA 402 v2.0 maps 607Dh; the Yaskawa document says that its drives do not.
    SOFTWARE_LIMIT_MIN, 0x607D:1, i32, ReadWrite, RX, Position, "software position limit: minimum";
    SOFTWARE_LIMIT_MAX, 0x607D:2, i32, ReadWrite, RX, Position, "software position limit: maximum";
    POLARITY, 0x607E:0, u8, ReadWrite, RX, None, "polarity";
    MAX_PROFILE_VELOCITY, 0x607F:0, u32, ReadWrite, RX, Velocity, "max profile velocity";
    MAX_MOTOR_SPEED, 0x6080:0, u32, ReadWrite, RX, RevolutionsPerMinute, "max motor speed";
    PROFILE_VELOCITY, 0x6081:0, u32, ReadWrite, RX, Velocity, "profile velocity";
    END_VELOCITY, 0x6082:0, u32, ReadWrite, RX, Velocity, "end velocity";
    PROFILE_ACCELERATION, 0x6083:0, u32, ReadWrite, RX, Acceleration, "profile acceleration";
    PROFILE_DECELERATION, 0x6084:0, u32, ReadWrite, RX, Acceleration, "profile deceleration";
    QUICK_STOP_DECELERATION, 0x6085:0, u32, ReadWrite, RX, Acceleration, "quick stop deceleration";
    MOTION_PROFILE_TYPE, 0x6086:0, i16, ReadWrite, RX, None, "motion profile type";
    ENCODER_INCREMENTS, 0x608F:1, u32, ReadWrite, RX, Increments, "position encoder resolution: increments";
    ENCODER_REVOLUTIONS, 0x608F:2, u32, ReadWrite, RX, Revolutions, "position encoder resolution: motor revolutions";
    VELOCITY_ENCODER_INCREMENTS, 0x6090:1, u32, ReadWrite, RX, IncrementsPerSecond, "velocity encoder resolution: increments per second";
    VELOCITY_ENCODER_REVOLUTIONS, 0x6090:2, u32, ReadWrite, RX, RevolutionsPerSecond, "velocity encoder resolution: motor revolutions per second";
    GEAR_MOTOR_REVOLUTIONS, 0x6091:1, u32, ReadWrite, RX, Revolutions, "gear ratio: motor revolutions";
    GEAR_SHAFT_REVOLUTIONS, 0x6091:2, u32, ReadWrite, RX, Revolutions, "gear ratio: shaft revolutions";
    FEED, 0x6092:1, u32, ReadWrite, RX, Position, "feed constant: feed";
    FEED_SHAFT_REVOLUTIONS, 0x6092:2, u32, ReadWrite, RX, Revolutions, "feed constant: shaft revolutions";
    POSITION_FACTOR_NUMERATOR, 0x6093:1, u32, ReadWrite, RX, None, "position factor: numerator";
    POSITION_FACTOR_DIVISOR, 0x6093:2, u32, ReadWrite, RX, None, "position factor: divisor";
    VELOCITY_ENCODER_FACTOR_NUMERATOR, 0x6094:1, u32, ReadWrite, RX, None, "velocity encoder factor: numerator";
    VELOCITY_ENCODER_FACTOR_DIVISOR, 0x6094:2, u32, ReadWrite, RX, None, "velocity encoder factor: divisor";
    VELOCITY_FACTOR_1_NUMERATOR, 0x6095:1, u32, ReadWrite, RX, None, "velocity factor 1: numerator";
    VELOCITY_FACTOR_1_DIVISOR, 0x6095:2, u32, ReadWrite, RX, None, "velocity factor 1: divisor";
    VELOCITY_FACTOR_NUMERATOR, 0x6096:1, u32, ReadWrite, NO, None, "velocity factor: numerator";
    VELOCITY_FACTOR_DIVISOR, 0x6096:2, u32, ReadWrite, NO, None, "velocity factor: divisor";
    ACCELERATION_FACTOR_NUMERATOR, 0x6097:1, u32, ReadWrite, NO, None, "acceleration factor: numerator";
    ACCELERATION_FACTOR_DIVISOR, 0x6097:2, u32, ReadWrite, NO, None, "acceleration factor: divisor";
    HOMING_METHOD, 0x6098:0, i8, ReadWrite, RX, None, "homing method";
    HOMING_SWITCH_SPEED, 0x6099:1, u32, ReadWrite, RX, Velocity, "homing speeds: during search for switch";
    HOMING_ZERO_SPEED, 0x6099:2, u32, ReadWrite, RX, Velocity, "homing speeds: during search for zero";
    HOMING_ACCELERATION, 0x609A:0, u32, ReadWrite, RX, Acceleration, "homing acceleration";
    PROFILE_JERK_1, 0x60A4:1, u32, ReadWrite, RX, Jerk, "profile jerk 1";
    PROFILE_JERK_2, 0x60A4:2, u32, ReadWrite, RX, Jerk, "profile jerk 2";
    SI_UNIT_POSITION, 0x60A8:0, u32, ReadWrite, NO, None, "SI unit position";
    SI_UNIT_VELOCITY, 0x60A9:0, u32, ReadWrite, NO, None, "SI unit velocity";
    SI_UNIT_ACCELERATION, 0x60AA:0, u32, ReadWrite, NO, None, "SI unit acceleration";
    TOUCH_PROBE_FUNCTION, 0x60B8:0, u16, ReadWrite, RX, None, "touch probe function";
    TOUCH_PROBE_STATUS, 0x60B9:0, u16, ReadOnly, TX, None, "touch probe status";
    TOUCH_PROBE_1_POSITIVE, 0x60BA:0, i32, ReadOnly, TX, Position, "touch probe 1: position at the positive edge";
    TOUCH_PROBE_1_NEGATIVE, 0x60BB:0, i32, ReadOnly, TX, Position, "touch probe 1: position at the negative edge";
    TOUCH_PROBE_2_POSITIVE, 0x60BC:0, i32, ReadOnly, TX, Position, "touch probe 2: position at the positive edge";
    TOUCH_PROBE_2_NEGATIVE, 0x60BD:0, i32, ReadOnly, TX, Position, "touch probe 2: position at the negative edge";
    INTERPOLATION_DATA, 0x60C1:1, i32, ReadWrite, RX, Position, "interpolation data record: first set-point";
    INTERPOLATION_PERIOD, 0x60C2:1, u8, ReadWrite, NO, None, "interpolation time period: value";
    INTERPOLATION_PERIOD_EXPONENT, 0x60C2:2, i8, ReadWrite, NO, None, "interpolation time period: exponent of ten, of seconds";
    MAX_ACCELERATION, 0x60C5:0, u32, ReadWrite, RX, Acceleration, "max acceleration";
    MAX_DECELERATION, 0x60C6:0, u32, ReadWrite, RX, Acceleration, "max deceleration";
    TOUCH_PROBE_1_SOURCE, 0x60D0:1, i16, ReadWrite, NO, None, "touch probe source: touch probe 1";
    TOUCH_PROBE_2_SOURCE, 0x60D0:2, i16, ReadWrite, NO, None, "touch probe source: touch probe 2";
    TOUCH_PROBE_1_POSITIVE_TIME, 0x60D1:0, u32, ReadOnly, TX, Nanoseconds, "touch probe 1: time stamp of the positive edge";
    TOUCH_PROBE_1_NEGATIVE_TIME, 0x60D2:0, u32, ReadOnly, TX, Nanoseconds, "touch probe 1: time stamp of the negative edge";
    TOUCH_PROBE_2_POSITIVE_TIME, 0x60D3:0, u32, ReadOnly, TX, Nanoseconds, "touch probe 2: time stamp of the positive edge";
    TOUCH_PROBE_2_NEGATIVE_TIME, 0x60D4:0, u32, ReadOnly, TX, Nanoseconds, "touch probe 2: time stamp of the negative edge";
    TOUCH_PROBE_1_POSITIVE_COUNTER, 0x60D5:0, u16, ReadOnly, TX, None, "touch probe 1: counter of positive edges";
    TOUCH_PROBE_1_NEGATIVE_COUNTER, 0x60D6:0, u16, ReadOnly, TX, None, "touch probe 1: counter of negative edges";
    TOUCH_PROBE_2_POSITIVE_COUNTER, 0x60D7:0, u16, ReadOnly, TX, None, "touch probe 2: counter of positive edges";
    TOUCH_PROBE_2_NEGATIVE_COUNTER, 0x60D8:0, u16, ReadOnly, TX, None, "touch probe 2: counter of negative edges";
    POSITIVE_TORQUE_LIMIT, 0x60E0:0, u16, ReadWrite, RX, ThousandthsOfRatedTorque, "positive torque limit";
    NEGATIVE_TORQUE_LIMIT, 0x60E1:0, u16, ReadWrite, RX, ThousandthsOfRatedTorque, "negative torque limit";
    SUPPORTED_HOMING_METHODS, 0x60E3:0, u8, ReadOnly, NO, None, "supported homing methods: number of methods";
    POSITIONING_OPTION, 0x60F2:0, u16, ReadWrite, RX, None, "positioning option code";
    FOLLOWING_ERROR_ACTUAL, 0x60F4:0, i32, ReadOnly, TX, Position, "following error actual value";
    POSITION_DEMAND_INTERNAL, 0x60FC:0, i32, ReadOnly, TX, Increments, "position demand internal value";
    DIGITAL_INPUTS, 0x60FD:0, u32, ReadOnly, TX, None, "digital inputs";
    DIGITAL_OUTPUTS, 0x60FE:1, u32, ReadWrite, RX, None, "digital outputs";
    DIGITAL_OUTPUTS_MASK, 0x60FE:2, u32, ReadWrite, RX, None, "digital outputs: bit mask";
    TARGET_VELOCITY, 0x60FF:0, i32, ReadWrite, RX, Velocity, "target velocity";
    MOTOR_TYPE, 0x6402:0, u16, ReadWrite, RX, None, "motor type";
    MOTOR_CATALOGUE_NUMBER, 0x6403:0, Vec<u8>, ReadWrite, NO, None, "motor catalogue number";
    MOTOR_MANUFACTURER, 0x6404:0, Vec<u8>, ReadWrite, NO, None, "motor manufacturer";
    SUPPORTED_MODES, 0x6502:0, u32, ReadOnly, TX, None, "supported drive modes";
    SINGLE_DEVICE_TYPE, 0x67FF:0, u32, ReadOnly, NO, None, "single device type";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_is_sorted_and_names_each_object_once() {
        let all = all();
        for pair in all.windows(2) {
            assert!(
                pair[0].address() < pair[1].address(),
                "{} before {}",
                pair[0].address(),
                pair[1].address()
            );
        }
    }

    #[test]
    fn an_object_of_varying_length_is_never_mappable_and_a_read_only_one_is_no_output() {
        for object in all() {
            assert!(
                object.bits() != 0 || object.mappable == Mappable::NO,
                "{}",
                object.name
            );
            assert!(
                object.writable || !object.mappable.outputs,
                "{}",
                object.name
            );
        }
    }

    #[test]
    fn widths_agree_with_the_list_of_related_objects_of_the_2010h_drive() {
        // (index, bits) of its page "Profile Position Mode (pp)", related objects.
        let page = [
            (0x2010, 16),
            (0x6040, 16),
            (0x6041, 16),
            (0x6062, 32),
            (0x6063, 32),
            (0x6064, 32),
            (0x6065, 32),
            (0x6066, 16),
            (0x6067, 32),
            (0x6068, 16),
            (0x607A, 32),
            (0x6081, 32),
            (0x6083, 32),
            (0x6084, 32),
            (0x6085, 32),
            (0x6086, 16),
            (0x60F4, 32),
        ];
        let all = all();
        for (index, bits) in page {
            let object = all.iter().find(|object| object.index == index);
            assert_eq!(
                object.map(super::super::object::AnyObject::bits),
                Some(bits),
                "{index:04X}h"
            );
        }
    }
}
