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
        0x0000 => "no error, or error reset",
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
        0x9000 => "external error",
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
