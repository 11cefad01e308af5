//! What clients may do beside looking and stopping: nothing, unless the program grants it.

use std::collections::HashMap;

use servocrab::{Axis, Network, coe::ObjectAddress, units::Scale};
use tokio::sync::mpsc;

use crate::AttachError;

/// What the program lets clients do. Without a grant they look, and stop axes.
///
/// ```
/// use servocrab_attach::{Attach, Grant};
/// let attach = Attach::new("eth0")
///     .grant(Grant::Parameters)
///     .grant(Grant::Jog { axes: vec!["x".into()], max_velocity: 20.0 });
/// # let _ = attach;
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Grant {
    /// They may write objects by SDO: not those of the process data, and not those that the library itself writes or relies on. Torque
    /// limits (6072h, 60E0h, 60E1h), digital outputs (60FEh) and the maker's objects may be written.
    Parameters,
    /// They may enable and disable these axes, reset their faults, bring a drive back into OP of which all axes are granted, and jog them for as long as somebody holds the jog.
    Jog {
        /// The names of the axes.
        axes: Vec<String>,
        /// No faster than this, in the axis' unit per second.
        max_velocity: f64,
    },
    /// They may enable and disable these axes, reset their faults, bring a drive back into OP of which all axes are granted, home them, and move them to positions. It bounds no velocity: a move has
    /// the one that the client names, within 607Fh or the program's [`Limits`](servocrab::profile_position::Limits). A homing has the speeds
    /// that the drive holds.
    Motion {
        /// The names of the axes.
        axes: Vec<String>,
    },
}

/// An axis that clients may move.
#[derive(Debug, Clone)]
pub(crate) struct GrantedAxis {
    /// Not counted among the program's.
    pub axis: Axis,
    pub scale: Scale,
    /// None: it may not be jogged.
    pub max_velocity: Option<f64>,
    /// Whether it may be moved to positions and homed.
    pub moves: bool,
}

/// All that is granted.
#[derive(Debug, Clone, Default)]
pub(crate) struct Granted {
    pub parameters: bool,
    pub axes: HashMap<String, GrantedAxis>,
}

impl Granted {
    pub fn of(net: &Network, grants: &[Grant]) -> Result<Self, AttachError> {
        let mut granted = Self::default();
        let view = net.view();
        let scales: HashMap<String, Scale> = view
            .axes()
            .into_iter()
            .map(|axis| (axis.identity.axis.to_string(), axis.scale))
            .collect();
        let mut add = |name: &String, change: &dyn Fn(&mut GrantedAxis)| {
            if !granted.axes.contains_key(name) {
                let axis = net.uncounted_axis(name);
                let axis = axis.map_err(|error| AttachError::Grant(error.to_string()))?;
                let scale = scales.get(name).copied().unwrap_or(Scale::COUNTS);
                let none = GrantedAxis {
                    axis,
                    scale,
                    max_velocity: None,
                    moves: false,
                };
                granted.axes.insert(name.clone(), none);
            }
            if let Some(axis) = granted.axes.get_mut(name) {
                change(axis);
            }
            Ok::<(), AttachError>(())
        };
        for grant in grants {
            match grant {
                Grant::Parameters => {}
                Grant::Jog { axes, max_velocity } => {
                    if !(max_velocity.is_finite() && *max_velocity > 0.0) {
                        return Err(AttachError::Grant(format!(
                            "the greatest velocity of a jog is {max_velocity}: it must be more than 0"
                        )));
                    }
                    for name in axes {
                        add(name, &|axis| axis.max_velocity = Some(*max_velocity))?;
                    }
                }
                Grant::Motion { axes } => {
                    for name in axes {
                        add(name, &|axis| axis.moves = true)?;
                    }
                }
            }
        }
        granted.parameters = grants.contains(&Grant::Parameters);
        Ok(granted)
    }
}

/// A client wants to move an axis whose mode the program holds. Who agrees drops its lease; the client then asks again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AskedFor {
    /// The axis' name.
    pub axis: String,
    /// Who asks: the user and the process, or the address.
    pub client: String,
}

/// Where the program hears what clients ask for.
pub(crate) type Asks = mpsc::Sender<AskedFor>;

/// The objects of a first axis that the library writes, or has read and relies on.
const OWNED: [u16; 44] = [
    0x6007, 0x6040, 0x6042, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6060, 0x6065, 0x6067, 0x6068,
    0x606D, 0x606E, 0x606F, 0x6070, 0x6071, 0x607A, 0x607B, 0x607C, 0x607D, 0x607E, 0x607F, 0x6080,
    0x6081, 0x6082, 0x6083, 0x6084, 0x6085, 0x6086, 0x60A3, 0x60A4, 0x60A8, 0x60A9, 0x60AA, 0x60B0,
    0x60B1, 0x60B2, 0x60C1, 0x60C2, 0x60C5, 0x60C6, 0x60F2, 0x60FF,
];

/// Whether the library itself writes this object or relies on what it holds: those of motion (targets and offsets of set-points in all
/// modes, jerks, the interpolation time), for each of eight axes, the homing 6098h to 609Ah, the factors 608Fh to 6097h and the SI units
/// 60A8h to 60AAh, and all of 1000h to 1FFFh (PDO mapping, sync managers, stored parameters).
pub(crate) fn is_owned(object: ObjectAddress) -> bool {
    match object.index {
        0x1000..=0x1FFF => true,
        0x6000..=0x9FFF => {
            let of_first = 0x6000 + (object.index - 0x6000) % 0x800;
            OWNED.contains(&of_first) || matches!(of_first, 0x608F..=0x609A)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_objects_of_motion_of_every_axis_are_the_librarys_and_those_of_the_maker_are_not() {
        for index in [
            0x1018, 0x1C12, 0x6040, 0x6840, 0x9860, 0x605A, 0x6898, 0x6091, 0x6093, 0x6894, 0x60A8,
            0x60A9, 0x60AA, 0x60A4, 0x68A4, 0x60C2, 0x68C2,
        ] {
            assert!(is_owned(ObjectAddress::new(index, 0)), "{index:04X}h");
        }
        for index in [0x2000, 0x3502, 0x5FFF, 0x6072, 0x6872, 0x60FE, 0xA000] {
            assert!(!is_owned(ObjectAddress::new(index, 0)), "{index:04X}h");
        }
    }

    #[test]
    fn targets_and_offsets_of_set_points_are_the_librarys() {
        for index in [0x6042, 0x6071, 0x60B0, 0x60B1, 0x60B2, 0x60C1, 0x68B0] {
            assert!(is_owned(ObjectAddress::new(index, 0)), "{index:04X}h");
        }
    }
}
