//! The devices of a line, by a seed, and how a program declares them.

use servocrab::{
    DriveConfig, Referencing,
    bus::{Expected, IoConfig, NetworkBuilder},
    drives::{self, DriveDescription},
};
use servocrab_sim::{Device, personality};

use crate::random::Random;

/// A device of the line, as it is declared.
pub enum Member {
    Drive(Box<DriveDescription>, Vec<String>),
    Io(IoConfig),
    Other(Expected),
}

pub fn member(random: &mut Random, position: usize) -> (Device, Member) {
    let drive = |device, description: DriveDescription| {
        let names = (0..description.axes.len()).map(|axis| format!("{position}.{axis}"));
        let names = names.collect();
        (device, Member::Drive(Box::new(description), names))
    };
    match random.below(9) {
        0 | 1 => drive(personality::akd2g(), drives::akd2g()),
        2 => drive(personality::generic(), drives::generic()),
        3 => drive(personality::ax2000(), drives::ax2000()),
        4 => drive(personality::sigma7(), drives::sigma7()),
        5 => drive(personality::pp2010(), drives::pp2010()),
        6 => {
            let io = IoConfig::new(&format!("{position}"), Expected::new(0, 0x4449_3038));
            (personality::digital_inputs(), Member::Io(io))
        }
        7 => {
            let io = IoConfig::new(&format!("{position}"), Expected::new(0, 0x444F_3038));
            (personality::digital_outputs(), Member::Io(io))
        }
        _ => {
            let coupler = Expected::new(0, 0x434F_5550);
            (personality::coupler(), Member::Other(coupler))
        }
    }
}

impl Member {
    /// Declares it at this position.
    pub fn declared(&self, builder: NetworkBuilder, position: u16) -> NetworkBuilder {
        match self {
            Self::Drive(description, axes) => {
                let config = DriveConfig::new((**description).clone());
                let config = axes.iter().fold(config, |config, axis| {
                    let config = config.axis(axis);
                    config.change_axis(axis, |axis| {
                        axis.referencing(Referencing::UnreferencedMovesAllowed)
                    })
                });
                builder.drive(position, config)
            }
            Self::Io(config) => builder.io(position, config.clone()),
            Self::Other(coupler) => builder.expect(position, coupler.clone()),
        }
    }
}
