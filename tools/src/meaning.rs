//! What the value of an object means, where the standard says so: its state, its bits, its enumeration (CiA 402, CiA 301, ETG.1000,
//! ETG.1020).

use serde_json::{Value, json};
use servocrab::{
    coe::{AxisOffset, ObjectAddress, obj},
    ds402::{AbortConnection, Mode, Statusword, describe_error_code},
};

/// A value in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Meaning {
    /// As the standard writes it, with what it stands for.
    pub(crate) text: String,
    /// The bits that are set, with their names.
    pub(crate) bits: Vec<(u32, String)>,
}

impl Meaning {
    fn of_text(text: impl Into<String>) -> Self {
        Self {
            text: text.into(),
            bits: Vec::new(),
        }
    }

    /// In one line.
    pub(crate) fn line(&self) -> String {
        let bits: Vec<_> = self
            .bits
            .iter()
            .map(|(bit, name)| format!("{bit} {name}"))
            .collect();
        match bits.is_empty() {
            true => self.text.clone(),
            false => format!("{}; bits {}", self.text, bits.join(", ")),
        }
    }

    pub(crate) fn json(&self) -> Value {
        let bits: Vec<_> = self
            .bits
            .iter()
            .map(|(bit, name)| json!({"bit": bit, "name": name}))
            .collect();
        json!({"text": self.text, "bits": bits})
    }
}

/// The index of the same object of a drive's first axis, and the axis.
pub(crate) fn of_first_axis(index: u16) -> (u16, u8) {
    match index {
        0x6000..=0x9FFF => {
            let axis = (index - 0x6000) / AxisOffset::PROFILE_STEP;
            (index - axis * AxisOffset::PROFILE_STEP, axis as u8 + 1)
        }
        _ => (index, 1),
    }
}

/// Whether the meaning of this object depends on the mode of operation.
pub(crate) fn depends_on_mode(object: ObjectAddress) -> bool {
    let (index, _) = of_first_axis(object.index);
    matches!(index, 0x6040 | 0x6041)
}

/// What these bytes of an object of a drive mean; nothing for a plain number. `mode` is what 6061h of its axis holds, where it is
/// known.
pub(crate) fn of(object: ObjectAddress, bytes: &[u8], mode: Option<i8>) -> Option<Meaning> {
    let (index, _) = of_first_axis(object.index);
    let mut raw = [0; 8];
    raw.get_mut(..bytes.len())?.copy_from_slice(bytes);
    let raw = u64::from_le_bytes(raw);
    let signed = || match *bytes {
        [byte] => Some(i64::from(byte.cast_signed())),
        [low, high] => Some(i64::from(i16::from_le_bytes([low, high]))),
        _ => None,
    };
    let number = |names: &[(i64, &str)]| {
        let value = signed()?;
        let name = names.iter().find(|(number, _)| *number == value);
        let name = name.map_or(
            if value < 0 {
                "the manufacturer's"
            } else {
                "reserved"
            },
            |(_, name)| name,
        );
        Some(Meaning::of_text(name))
    };
    let hexadecimal = || format!("{raw:0width$X}h", width = 2 * bytes.len());
    let bits = |names: &dyn Fn(u32) -> Option<&'static str>| {
        Some(Meaning {
            text: hexadecimal(),
            bits: set_bits(raw, names),
        })
    };
    match (index, object.subindex, bytes.len()) {
        (0x1000, 0, 4) => Some(Meaning::of_text(device_type(raw))),
        (0x1001, 0, 1) => bits(&|bit| ERROR_REGISTER.get(bit as usize).copied()),
        (0x1003, 1.., 4) | (0x603F, 0, 2) => Some(Meaning::of_text(match raw {
            0 => "no error".into(),
            _ => format!("{}: {}", hexadecimal(), describe_error_code(raw as u16)),
        })),
        (0x1018, 1..=4, 4) => Some(Meaning::of_text(hexadecimal())),
        (0x1600..=0x17FF | 0x1A00..=0x1BFF, 1.., 4) => Some(Meaning::of_text(mapped(raw as u32))),
        (0x1C12 | 0x1C13, 1.., 2) => Some(Meaning::of_text(hexadecimal())),
        (0x1C32 | 0x1C33, 1, 2) => number(&SYNC_TYPES),
        (0x1C32 | 0x1C33, 4, 2) => bits(&sync_types_supported),
        (0x6007, 0, 2) => {
            let option = AbortConnection::from_raw(i16::try_from(signed()?).ok()?);
            Some(Meaning::of_text(match option {
                AbortConnection::NoAction => {
                    "no action: the axis goes on when the process data stop"
                }
                AbortConnection::Malfunction => "a fault when the process data stop",
                AbortConnection::DisableVoltage => {
                    "disable voltage when the process data stop: the axis coasts"
                }
                AbortConnection::QuickStop => "quick stop when the process data stop",
                AbortConnection::Other(..0) => "the manufacturer's",
                AbortConnection::Other(_) => "reserved",
            }))
        }
        (0x6040, 0, 2) => bits(&|bit| controlword(bit, mode)),
        (0x6041, 0, 2) => {
            let word = Statusword::from_bits_retain(raw as u16);
            Some(Meaning {
                text: format!("{word} {}", word.state()),
                bits: set_bits(raw, &|bit| statusword(bit, mode)),
            })
        }
        (0x605A, 0, 2) => number(&QUICK_STOP),
        (0x605B | 0x605C, 0, 2) => number(&DISABLE),
        (0x605D, 0, 2) => number(&HALT),
        (0x605E, 0, 2) => number(&FAULT_REACTION),
        (0x6060 | 0x6061, 0, 1) => {
            let mode = i8::try_from(signed()?).ok()?;
            Some(Meaning::of_text(match Mode::from_raw(mode) {
                Mode::None => "no mode".into(),
                Mode::Other(..0) => "the manufacturer's mode".into(),
                known => known.to_string(),
            }))
        }
        (0x6086, 0, 2) => number(&[
            (0, "linear ramp (trapezoidal profile)"),
            (1, "sin² ramp"),
            (2, "jerk-free ramp"),
            (3, "jerk-limited ramp"),
        ]),
        (0x60B8, 0, 2) => bits(&touch_probe),
        (0x60B9, 0, 2) => bits(&touch_probe_status),
        (0x60FD, 0, 4) => bits(&|bit| match bit {
            0 => Some("negative limit switch"),
            1 => Some("positive limit switch"),
            2 => Some("home switch"),
            3 => Some("interlock"),
            _ => None,
        }),
        (0x60FE, 1 | 2, 4) => bits(&|bit| (bit == 0).then_some("set brake")),
        (0x6502, 0, 4) => bits(&supported_mode),
        _ => None,
    }
}

fn set_bits(raw: u64, name: &dyn Fn(u32) -> Option<&'static str>) -> Vec<(u32, String)> {
    let set = (0..64).filter(|bit| raw >> bit & 1 == 1);
    set.map(|bit| (bit, name(bit).unwrap_or("without a name").to_owned()))
        .collect()
}

/// ETG.6010: the profile in the low word, for CiA 402 the kind of drive in the bits above.
fn device_type(raw: u64) -> String {
    let profile = raw & 0xFFFF;
    if profile != 402 {
        return match profile {
            0 => "no standard profile".into(),
            5001 => "modular device profile (5001)".into(),
            _ => format!("device profile {profile}"),
        };
    }
    let kind = match raw >> 16 & 0xFF {
        1 => "frequency converter",
        2 => "servo drive",
        4 => "stepper drive",
        _ => "drive",
    };
    format!("{kind} (CiA 402)")
}

/// An entry of a PDO: index, subindex, bits.
fn mapped(raw: u32) -> String {
    let object = ObjectAddress::new((raw >> 16) as u16, (raw >> 8) as u8);
    let bits = raw & 0xFF;
    if object.index == 0 {
        return format!("{bits} bits that mean nothing");
    }
    let (first, axis) = of_first_axis(object.index);
    let first = ObjectAddress::new(first, object.subindex);
    let known = obj::all()
        .into_iter()
        .find(|known| known.address() == first);
    match known {
        Some(known) if axis > 1 => format!("{object}, {bits} bits: {} of axis {axis}", known.name),
        Some(known) => format!("{object}, {bits} bits: {}", known.name),
        None => format!("{object}, {bits} bits"),
    }
}

/// CiA 301, object 1001h.
const ERROR_REGISTER: [&str; 8] = [
    "generic error",
    "current",
    "voltage",
    "temperature",
    "communication",
    "device profile",
    "reserved",
    "the manufacturer's",
];

/// ETG.1020, 1C32h:1.
const SYNC_TYPES: [(i64, &str); 5] = [
    (0, "free run"),
    (1, "synchronous with SM event"),
    (2, "DC SYNC0"),
    (3, "DC SYNC1"),
    (34, "synchronous with SM2 event"),
];

/// ETG.1020, 1C32h:4. Bits 2 to 4 and 5 to 6 are numbers, of which each bit has a name of its own.
fn sync_types_supported(bit: u32) -> Option<&'static str> {
    Some(match bit {
        0 => "free run",
        1 => "synchronous with SM event",
        2 => "DC SYNC0",
        3 => "DC SYNC1",
        4 => "DC, subordinate with fixed SYNC0",
        5 => "outputs shifted by a local timer",
        6 => "outputs shifted by SYNC1",
        14 => "dynamic cycle times",
        _ => return None,
    })
}

/// CiA 402, objects 605Ah to 605Eh.
const QUICK_STOP: [(i64, &str); 9] = [
    (0, "disable drive function: the axis coasts"),
    (1, "slow-down ramp, then Switch on disabled"),
    (2, "quick stop ramp, then Switch on disabled"),
    (3, "current limit, then Switch on disabled"),
    (4, "voltage limit, then Switch on disabled"),
    (5, "slow-down ramp, then stays in Quick stop active"),
    (6, "quick stop ramp, then stays in Quick stop active"),
    (7, "current limit, then stays in Quick stop active"),
    (8, "voltage limit, then stays in Quick stop active"),
];
const DISABLE: [(i64, &str); 2] = [
    (0, "disable drive function: the axis coasts"),
    (1, "slow-down ramp, then disabled"),
];
const HALT: [(i64, &str); 5] = [
    (0, "disable drive function: the axis coasts"),
    (1, "slow-down ramp"),
    (2, "quick stop ramp"),
    (3, "current limit"),
    (4, "voltage limit"),
];
const FAULT_REACTION: [(i64, &str); 5] = [
    (0, "disable drive function: the axis coasts"),
    (1, "slow-down ramp"),
    (2, "quick stop ramp"),
    (3, "current limit"),
    (4, "voltage limit"),
];

fn controlword(bit: u32, mode: Option<i8>) -> Option<&'static str> {
    let mode = mode.map(Mode::from_raw);
    Some(match (bit, mode) {
        (0, _) => "switch on",
        (1, _) => "enable voltage",
        (2, _) => "quick stop (active low)",
        (3, _) => "enable operation",
        (4, Some(Mode::ProfilePosition)) => "new set-point",
        (4, Some(Mode::Homing)) => "homing operation start",
        (5, Some(Mode::ProfilePosition)) => "change set immediately",
        (6, Some(Mode::ProfilePosition)) => "relative",
        (9, Some(Mode::ProfilePosition)) => "change on set-point",
        (4 | 5 | 6 | 9, _) => "by the mode",
        (7, _) => "fault reset",
        (8, _) => "halt",
        (11.., _) => "the manufacturer's",
        _ => return None,
    })
}

fn statusword(bit: u32, mode: Option<i8>) -> Option<&'static str> {
    let mode = mode.map(Mode::from_raw);
    Some(match (bit, mode) {
        (0, _) => "ready to switch on",
        (1, _) => "switched on",
        (2, _) => "operation enabled",
        (3, _) => "fault",
        (4, _) => "voltage enabled",
        (5, _) => "quick stop (active low)",
        (6, _) => "switch on disabled",
        (7, _) => "warning",
        (9, _) => "remote",
        (10, _) => "target reached",
        (11, _) => "internal limit active",
        (12, Some(Mode::ProfilePosition)) => "set-point acknowledge",
        (12, Some(Mode::ProfileVelocity)) => "speed is zero",
        (12, Some(Mode::Homing)) => "homing attained",
        (12, Some(Mode::CyclicPosition | Mode::CyclicVelocity | Mode::CyclicTorque)) => {
            "drive follows the command value"
        }
        (13, Some(Mode::ProfilePosition | Mode::CyclicPosition)) => "following error",
        (13, Some(Mode::ProfileVelocity)) => "max slippage error",
        (13, Some(Mode::Homing)) => "homing error",
        (12 | 13, _) => "by the mode",
        (8 | 14 | 15, _) => "the manufacturer's",
        _ => return None,
    })
}

fn supported_mode(bit: u32) -> Option<&'static str> {
    Some(match bit {
        0 => "profile position",
        1 => "velocity",
        2 => "profile velocity",
        3 => "profile torque",
        5 => "homing",
        6 => "interpolated position",
        7 => "cyclic synchronous position",
        8 => "cyclic synchronous velocity",
        9 => "cyclic synchronous torque",
        10 => "cyclic synchronous torque with commutation angle",
        16.. => "the manufacturer's",
        _ => return None,
    })
}

fn touch_probe(bit: u32) -> Option<&'static str> {
    Some(match bit {
        0 => "touch probe 1 enabled",
        1 => "touch probe 1: each event",
        2 => "touch probe 1: zero pulse",
        3 => "touch probe 1: the source of 60D0h:1",
        4 => "touch probe 1: positive edge",
        5 => "touch probe 1: negative edge",
        8 => "touch probe 2 enabled",
        9 => "touch probe 2: each event",
        10 => "touch probe 2: zero pulse",
        11 => "touch probe 2: the source of 60D0h:2",
        12 => "touch probe 2: positive edge",
        13 => "touch probe 2: negative edge",
        _ => return None,
    })
}

fn touch_probe_status(bit: u32) -> Option<&'static str> {
    Some(match bit {
        0 => "touch probe 1 enabled",
        1 => "touch probe 1: 60BAh holds a positive edge",
        2 => "touch probe 1: 60BBh holds a negative edge",
        8 => "touch probe 2 enabled",
        9 => "touch probe 2: 60BCh holds a positive edge",
        10 => "touch probe 2: 60BDh holds a negative edge",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(object: &str, bytes: &[u8], mode: Option<i8>) -> Option<String> {
        of(object.parse().unwrap(), bytes, mode).map(|meaning| meaning.line())
    }

    #[test]
    fn words_show_their_state_and_their_bits_by_the_mode() {
        assert_eq!(
            line("6041h", &[0x50, 0x02], None).unwrap(),
            "0250h Switch on disabled; bits 4 voltage enabled, 6 switch on disabled, 9 remote"
        );
        // The second axis of a drive, and bit 12 in three modes.
        let bit_12 = |mode| of("6841h".parse().unwrap(), &[0, 0x10], mode).unwrap().bits;
        assert_eq!(bit_12(Some(1)), [(12, "set-point acknowledge".into())]);
        assert_eq!(bit_12(Some(6)), [(12, "homing attained".into())]);
        assert_eq!(bit_12(None), [(12, "by the mode".into())]);
        assert_eq!(
            line("6040h", &[0x1F, 0], Some(1)).unwrap(),
            "001Fh; bits 0 switch on, 1 enable voltage, 2 quick stop (active low), 3 enable operation, 4 new set-point"
        );
    }

    #[test]
    fn enumerations_show_their_names_and_numbers_without_one_say_so() {
        let text = |object, bytes: &[u8]| line(object, bytes, None).unwrap();
        assert_eq!(
            text("605Ah", &[6, 0]),
            "quick stop ramp, then stays in Quick stop active"
        );
        assert_eq!(text("605Ah", &[0xFF, 0xFF]), "the manufacturer's");
        assert_eq!(text("605Ah", &[9, 0]), "reserved");
        assert_eq!(text("6061h", &[6]), "homing mode (6)");
        assert_eq!(text("1C32h:1", &[2, 0]), "DC SYNC0");
        assert_eq!(text("1000h", &[0x92, 1, 2, 0]), "servo drive (CiA 402)");
        assert_eq!(text("603Fh", &[0, 0]), "no error");
        assert_eq!(
            text("1600h:1", &[0x10, 0, 0x40, 0x60]),
            "6040h:00, 16 bits: controlword"
        );
        assert_eq!(
            text("1610h:2", &[0x20, 0, 0x7A, 0x68]),
            "687Ah:00, 32 bits: target position of axis 2"
        );
    }

    #[test]
    fn a_plain_number_or_bytes_of_another_length_have_no_meaning() {
        assert_eq!(line("6064h", &[1, 0, 0, 0], None), None);
        assert_eq!(line("6041h", &[1, 0, 0, 0], None), None);
        assert_eq!(line("1008h", &[0x41; 20], None), None);
        assert_eq!(line("6041h", &[], None), None);
    }
}
