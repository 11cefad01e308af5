//! Error codes of object 603Fh and of emergencies, as words.
//!
//! Source: CiA DSP 402 v2.0, table 2, and the communication groups of CiA 301. Manufacturer codes get their group's words.

/// What an error code (603Fh, or the first word of an emergency) means, as text.
///
/// ```
/// assert_eq!(servocrab::ds402::describe_error_code(0x8611), "following error");
/// ```
#[must_use]
pub const fn describe(code: u16) -> &'static str {
    match code {
        0x2110 => "short circuit or earth leakage at the input",
        0x2211 => "current inside the device, no. 1",
        0x2220 => "continuous over-current inside the device",
        0x2310 => "continuous over-current at the output",
        0x2320 => "short circuit or earth leakage at the output",
        0x2340 => "short circuit at the output",
        0x3110 => "mains over-voltage",
        0x3120 => "mains under-voltage",
        0x3130 => "mains phase failure",
        0x3210 => "DC link over-voltage",
        0x3220 => "DC link under-voltage",
        0x4210 => "over-temperature of the device",
        0x4310 => "over-temperature of the drive",
        0x5112 => "24 V supply low",
        0x5530 => "non-volatile memory",
        0x6010 => "software reset by watchdog",
        0x6320 => "parameter error",
        0x7121 => "motor blocked",
        0x7122 => "motor error or commutation malfunction",
        0x7303 => "resolver 1 fault",
        0x7305 => "incremental encoder 1 fault",
        0x7310 => "speed",
        0x7320 => "position",
        0x8130 => "life guard or heartbeat error",
        0x8210 => "process data not processed: length error",
        0x8311 => "excess torque",
        0x8611 => "following error",
        0x8612 => "reference limit",
        0x8700 => "synchronisation controller",
        0xF001 => "deceleration",
        _ => group(code),
    }
}

/// The kind of error, by the code's group.
const fn group(code: u16) -> &'static str {
    match code {
        0xA000 => "transition from PREOP to SAFEOP not successful",
        0xA001 => "transition from SAFEOP to OP not successful",
        code => match code >> 8 {
            0x00 => "no error, or error reset",
            0x10..=0x1F => "generic error",
            0x21 => "current on the device's input side",
            0x22 => "current inside the device",
            0x23 => "current on the device's output side",
            0x20..=0x2F => "current",
            0x31 => "mains voltage",
            0x32 => "DC link voltage",
            0x30..=0x3F => "voltage",
            0x40..=0x4F => "temperature",
            0x50..=0x5F => "device hardware",
            0x60..=0x6F => "device software",
            0x71 => "motor or brake",
            0x73 => "sensor",
            0x75 => "communication inside the device",
            0x70..=0x7F => "additional modules",
            0x81 | 0x82 => "communication or protocol",
            0x80..=0x8F => "monitoring and control",
            0x90..=0x9F => "external error",
            0xA0 => "EtherCAT state change not successful",
            0xF0..=0xFE => "additional functions",
            0xFF => "manufacturer specific",
            _ => "not described by DS402",
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_codes_of_table_2_have_words_of_their_own() {
        let mut before = "";
        for code in [
            0x2110, 0x2211, 0x2220, 0x2310, 0x2320, 0x2340, 0x3110, 0x3120, 0x3130, 0x3210, 0x3220,
            0x4210, 0x4310, 0x5112, 0x5530, 0x6010, 0x6320, 0x7121, 0x7122, 0x7303, 0x7305, 0x7310,
            0x7320, 0x8130, 0x8210, 0x8311, 0x8611, 0x8612, 0x8700, 0xF001,
        ] {
            let words = describe(code);
            assert_ne!(words, group(code), "{code:04X}");
            assert_ne!(words, before, "{code:04X}");
            // The next one is not named.
            let beside = code ^ 0x0008;
            assert_eq!(describe(beside), group(beside), "{beside:04X}");
            before = words;
        }
        assert_eq!(describe(0x3120), "mains under-voltage");
        assert_eq!(describe(0x7320), "position");
    }

    #[test]
    fn the_other_codes_have_those_of_their_group() {
        for (first, last, words) in [
            (0x0000, 0x00FF, "no error, or error reset"),
            (0x0100, 0x0FFF, "not described by DS402"),
            (0x1000, 0x1FFF, "generic error"),
            (0x2000, 0x20FF, "current"),
            (0x2100, 0x21FF, "current on the device's input side"),
            (0x2201, 0x22FF, "current inside the device"),
            (0x2300, 0x23FF, "current on the device's output side"),
            (0x2400, 0x2FFF, "current"),
            (0x3000, 0x30FF, "voltage"),
            (0x3100, 0x31FF, "mains voltage"),
            (0x3200, 0x32FF, "DC link voltage"),
            (0x3300, 0x3FFF, "voltage"),
            (0x4000, 0x4FFF, "temperature"),
            (0x5000, 0x5FFF, "device hardware"),
            (0x6000, 0x6FFF, "device software"),
            (0x7000, 0x70FF, "additional modules"),
            (0x7100, 0x71FF, "motor or brake"),
            (0x7200, 0x72FF, "additional modules"),
            (0x7300, 0x73FF, "sensor"),
            (0x7400, 0x74FF, "additional modules"),
            (0x7500, 0x75FF, "communication inside the device"),
            (0x7600, 0x7FFF, "additional modules"),
            (0x8000, 0x80FF, "monitoring and control"),
            (0x8100, 0x82FF, "communication or protocol"),
            (0x8300, 0x8FFF, "monitoring and control"),
            (0x9000, 0x9FFF, "external error"),
            (
                0xA000,
                0xA000,
                "transition from PREOP to SAFEOP not successful",
            ),
            (
                0xA001,
                0xA001,
                "transition from SAFEOP to OP not successful",
            ),
            (0xA002, 0xA0FF, "EtherCAT state change not successful"),
            (0xA100, 0xEFFF, "not described by DS402"),
            (0xF000, 0xF000, "additional functions"),
            (0xF002, 0xFEFF, "additional functions"),
            (0xFF00, 0xFFFF, "manufacturer specific"),
        ] {
            for code in [first, last] {
                assert_eq!(describe(code), words, "{code:04X}");
            }
        }
    }
}
