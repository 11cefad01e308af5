//! The EtherCAT line of this machine, as `servocrab init` found it.

use std::{error::Error, time::Duration};

use servocrab::bus::NetworkBuilder;

/// The network of this line, and of no other.
///
/// # Errors
/// An ESI file that cannot be used.
pub fn line(network: NetworkBuilder) -> Result<NetworkBuilder, Box<dyn Error>> {
    Ok(network
        .cycle(Duration::from_micros(1000))
        .complete()
        .expect(
            0u16,
            servocrab::bus::Expected::new(0x00000000, 0x434F5550)
                .named("Coupler")
                .revision(0x00000001),
        )
        .drive(
            1u16,
            servocrab::DriveConfig::new(servocrab::drives::DriveDescription {
                vendor: Some(0x0000006A),
                product: Some(0x414B4432),
                ..servocrab::drives::akd2g()
            })
            .revision(0x00000001)
            .axis("1-1")
            .axis("1-2"),
        )
        .io(
            2u16,
            servocrab::bus::IoConfig::new(
                "io 2",
                servocrab::bus::Expected::new(0x00000000, 0x494F3136)
                    .named("16 outputs, 16 inputs")
                    .revision(0x00000001),
            ),
        )
        .drive(
            3u16,
            servocrab::DriveConfig::new(servocrab::drives::DriveDescription {
                vendor: Some(0x00000000),
                product: Some(0x44530402),
                ..servocrab::drives::generic().with_axes(1, 0x10)
            })
            .revision(0x00000001)
            .axis("3-1"),
        )
        .drive(
            4u16,
            servocrab::DriveConfig::new(servocrab::drives::DriveDescription {
                vendor: Some(0x00000000),
                product: Some(0x50502010),
                ..{
                    let mut drive = servocrab::drives::generic();
                    // What this drive does not have.
                    let absent = [(0x606C, 0)];
                    for axis in &mut drive.axes {
                        for objects in [&mut axis.outputs, &mut axis.inputs] {
                            objects.retain(|object| {
                                !absent.contains(&(object.index, object.subindex))
                            });
                        }
                    }
                    drive.with_axes(1, 0x10)
                }
            })
            .revision(0x00000001)
            .axis("4-1"),
        ))
}

/// Inputs and outputs of `io 2`, position 2: 16 outputs, 16 inputs.
pub mod io_2 {
    /// 7000h:01, output of 16 bit(s).
    pub const OUTPUTS: &str = "Outputs";
    /// 6000h:01, input of 16 bit(s).
    pub const INPUTS: &str = "Inputs";
}
