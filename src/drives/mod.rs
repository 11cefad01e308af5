//! What is known of particular drives, as data: identity, axes, PDOs, the mapping that is used by default.
//!
//! A [`DriveDescription`] is plain data: take one of the functions below and change its fields for a drive
//! that is not listed.

use alloc::vec::Vec;

use crate::coe::{AnyObject, AxisOffset, obj};
use crate::pdo_map::{Direction, Limits, Mapping, MappingError};
use crate::profile_position::Traits;

mod akd2g;
mod ax2000;
mod generic;
mod pp2010;
mod sigma7;

pub use akd2g::akd2g;
pub use ax2000::ax2000;
pub use generic::generic;
pub use pp2010::pp2010;
pub use sigma7::sigma7;

/// What the library must know of a drive to configure it.
///
/// ```
/// use servocrab::drives;
///
/// let mut drive = drives::akd2g();
/// drive.axes.truncate(1); // only the first axis is used
/// let mapping = drive.default_mapping()?;
/// assert_eq!(mapping.layout().output_bytes(), 19);
/// # Ok::<(), servocrab::pdo_map::MappingError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriveDescription {
    /// The drive's name, for messages.
    pub name: &'static str,
    /// The vendor ID that the drive must show; `None` accepts any.
    pub vendor: Option<u32>,
    /// The product code that the drive must show; `None` accepts any.
    pub product: Option<u32>,
    /// The axes, in order.
    pub axes: Vec<AxisDescription>,
    /// What a mapping may hold at most.
    pub limits: Limits,
    /// How its Profile Position mode behaves.
    pub traits: Traits,
}

impl DriveDescription {
    /// Whether a drive with this identity is one of those described.
    #[must_use]
    pub fn matches(&self, identity: &crate::sii::Identity) -> bool {
        self.vendor.is_none_or(|vendor| vendor == identity.vendor)
            && self
                .product
                .is_none_or(|product| product == identity.product)
    }

    /// The description of axis `axis`, counted from 1.
    #[must_use]
    pub fn axis(&self, axis: u8) -> Option<&AxisDescription> {
        self.axes.get(usize::from(axis).checked_sub(1)?)
    }

    /// The mapping of all axes that is used where a program declares none.
    ///
    /// # Errors
    /// [`MappingError`] if the description asks for more than its limits, or for an object twice.
    pub fn default_mapping(&self) -> Result<Mapping, MappingError> {
        let mut builder = Mapping::builder().limits(self.limits);
        for axis in &self.axes {
            builder = builder.offset(axis.offset).rx_pdo(axis.rx_pdo);
            for object in &axis.outputs {
                builder = builder.object(Direction::Outputs, *object);
            }
            builder = builder.tx_pdo(axis.tx_pdo);
            for object in &axis.inputs {
                builder = builder.object(Direction::Inputs, *object);
            }
        }
        builder.build()
    }
}

/// One axis of a drive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AxisDescription {
    /// How far its objects lie above those of the first axis.
    pub offset: AxisOffset,
    /// The RxPDO that is given to it.
    pub rx_pdo: u16,
    /// The TxPDO that is given to it.
    pub tx_pdo: u16,
    /// What the master writes every cycle, as objects of the first axis.
    pub outputs: Vec<AnyObject>,
    /// What the master reads every cycle, as objects of the first axis.
    pub inputs: Vec<AnyObject>,
}

impl AxisDescription {
    /// Axis `axis`, counted from 1, with the usual offsets and the objects that Profile Position needs.
    #[must_use]
    pub fn profile_position(axis: u8, rx_pdo: u16, tx_pdo: u16) -> Self {
        Self {
            offset: AxisOffset::of_axis(axis),
            rx_pdo,
            tx_pdo,
            outputs: alloc::vec![
                obj::CONTROLWORD.into(),
                obj::MODE_OF_OPERATION.into(),
                obj::TARGET_POSITION.into(),
                obj::PROFILE_VELOCITY.into(),
                obj::PROFILE_ACCELERATION.into(),
                obj::PROFILE_DECELERATION.into(),
            ],
            inputs: alloc::vec![
                obj::STATUSWORD.into(),
                obj::MODE_OF_OPERATION_DISPLAY.into(),
                obj::POSITION_ACTUAL.into(),
                obj::VELOCITY_ACTUAL.into(),
            ],
        }
    }
}
