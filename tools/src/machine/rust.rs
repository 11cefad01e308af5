//! The line as Rust source.

use std::fmt::Write as _;

use super::{Device, Direction, Kind, Machine, io_name};

/// A module that adds the line to a network, with the names of its inputs and outputs.
pub(super) fn source(machine: &Machine) -> String {
    let mut text = String::from(
        "//! The EtherCAT line of this machine, as `servocrab init` found it.\n\n\
         use std::{error::Error, time::Duration};\n\n\
         use servocrab::bus::NetworkBuilder;\n\n\
         /// The network of this line, and of no other.\n\
         ///\n\
         /// # Errors\n\
         /// An ESI file that cannot be used.\n\
         pub fn line(network: NetworkBuilder) -> Result<NetworkBuilder, Box<dyn Error>> {\n",
    );
    let _ = write!(
        text,
        "    Ok(network\n        .cycle(Duration::from_micros({}))\n        .complete()",
        machine.cycle_us
    );
    for (position, device) in (0..).zip(&machine.devices) {
        let place = format!("{position}u16");
        let _ = match device.kind {
            Kind::Other => write!(text, "\n        .expect({place}, {})", expected(device)),
            Kind::Io => write!(
                text,
                "\n        .io({place}, servocrab::bus::IoConfig::new({:?}, {}))",
                io_name(position),
                expected(device)
            ),
            _ => write!(text, "\n        .drive({place}, {})", drive(device)),
        };
    }
    text.push_str(")\n}\n");
    for (position, device) in (0..).zip(&machine.devices) {
        if device.kind == Kind::Io {
            text.push_str(&names(position, device));
        }
    }
    text
}

fn expected(device: &Device) -> String {
    let mut text = format!(
        "servocrab::bus::Expected::new(0x{:08X}, 0x{:08X}).named({:?}).revision(0x{:08X})",
        device.vendor, device.product, device.name, device.revision
    );
    if device.serial != 0 {
        let _ = write!(text, ".serial(0x{:08X})", device.serial);
    }
    text
}

fn drive(device: &Device) -> String {
    let mut text = format!(
        "{}\n        .revision(0x{:08X})",
        described(device),
        device.revision
    );
    if device.serial != 0 {
        let _ = write!(text, "\n        .serial(0x{:08X})", device.serial);
    }
    if let Some(word) = device.assign_activate {
        let _ = write!(
            text,
            "\n        .dc(servocrab::bus::DistributedClock::new(0x{word:04X}))"
        );
    }
    for axis in &device.axes {
        let _ = write!(text, "\n        .axis({:?})", axis.name);
    }
    text
}

/// The drive by its description, or by its maker's file.
fn described(device: &Device) -> String {
    let description = match device.kind {
        Kind::Esi => {
            let file = device
                .esi
                .as_ref()
                .map(|file| file.to_string_lossy().into_owned());
            return format!(
                "servocrab::DriveConfig::from_esi(servocrab::esi::Esi::load({:?})?\n            .device(0x{:08X}, 0x{:08X})?)?",
                file.unwrap_or_default(),
                device.product,
                device.revision
            );
        }
        Kind::Generic => {
            let absent: Vec<_> = device
                .absent
                .iter()
                .map(|object| format!("({:#06X}, {})", object.0.index, object.0.subindex))
                .collect();
            let mut text =
                String::from("{\n            let mut drive = servocrab::drives::generic();\n");
            if !absent.is_empty() {
                let _ = write!(
                    text,
                    "            // What this drive does not have.\n            let absent = [{}];\n            \
                     for axis in &mut drive.axes {{\n                for objects in [&mut axis.outputs, &mut axis.inputs] {{\n                    \
                     objects.retain(|object| !absent.contains(&(object.index, object.subindex)));\n                }}\n            }}\n",
                    absent.join(", ")
                );
            }
            let _ = write!(
                text,
                "            drive.with_axes({}, 0x10)\n        }}",
                device.axes.len().max(1)
            );
            // Without anything absent nothing is changed.
            match absent.is_empty() {
                true => format!(
                    "servocrab::drives::generic().with_axes({}, 0x10)",
                    device.axes.len().max(1)
                ),
                false => text,
            }
        }
        kind => format!("servocrab::drives::{}()", kind.name()),
    };
    format!(
        "servocrab::DriveConfig::new(servocrab::drives::DriveDescription {{\n            vendor: Some(0x{:08X}),\n            \
         product: Some(0x{:08X}),\n            ..{description}\n        }})",
        device.vendor, device.product
    )
}

/// The names of a device's inputs and outputs, each once.
fn names(position: u16, device: &Device) -> String {
    let mut text = format!(
        "\n/// Inputs and outputs of `{}`, position {position}: {}.\npub mod io_{position} {{\n",
        io_name(position),
        one_line(&device.name)
    );
    let mut used = Vec::new();
    for point in device.points.iter().filter(|point| !point.name.is_empty()) {
        let direction = match point.direction {
            Direction::Input => "input",
            Direction::Output => "output",
        };
        let constant = constant(&point.name);
        if used.contains(&constant) {
            continue;
        }
        let _ = writeln!(
            text,
            "    /// {}, {direction} of {} bit(s).\n    pub const {constant}: &str = {:?};",
            point.object.0, point.bits, point.name
        );
        used.push(constant);
    }
    text.push_str("}\n");
    text
}

fn one_line(text: &str) -> String {
    text.chars()
        .map(|letter| if letter.is_control() { ' ' } else { letter })
        .collect()
}

/// A name of the device's as the name of a constant.
fn constant(name: &str) -> String {
    let mut text = String::new();
    for letter in name.chars() {
        match letter.to_ascii_uppercase() {
            letter if letter.is_ascii_alphanumeric() => text.push(letter),
            _ if text.ends_with('_') || text.is_empty() => {}
            _ => text.push('_'),
        }
    }
    let text = text.trim_end_matches('_');
    match text.starts_with(|letter: char| letter.is_ascii_digit()) || text.is_empty() {
        true => format!("POINT_{text}"),
        false => text.to_owned(),
    }
}
