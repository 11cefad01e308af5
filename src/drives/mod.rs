//! What is known of particular drives, as data: identity, axes, PDOs, the mapping that is used by default.
//!
//! A [`DriveDescription`] is plain data: take one of the functions below and change its fields for a drive
//! that is not listed.

use alloc::borrow::Cow;
use alloc::vec::Vec;

use crate::coe::{AnyObject, AxisOffset, ErrorTexts, obj};
use crate::pdo_map::{Demand, Direction, FixedPdo, Mapping, MappingError, MappingLimits, choose};
use crate::profile_position::Traits;
use crate::sii::Identity;

mod akd2g;
mod ax2000;
mod generic;
mod pp2010;
mod sigma7;

pub use akd2g::{Akd2gMotionStatus, akd2g};
pub use ax2000::ax2000;
pub use generic::generic;
pub use pp2010::pp2010;
pub use sigma7::sigma7;

/// The description in this module of a drive with this identity, as a suggestion for a device that a scan has found.
///
/// Some descriptions have no product code, because no document at hand names one. They match each device of their maker, also one that
/// is no drive: what answers a read of 6041h by SDO is one. [`generic`] and [`pp2010`] match any identity and are never suggested.
///
/// ```
/// use servocrab::{drives, sii::Identity};
///
/// let found = Identity { vendor: 0x0000_006A, ..Identity::default() };
/// let drive = drives::for_identity(&found).unwrap_or_else(drives::generic);
/// assert_eq!(drive.name, "AKD2G");
/// ```
#[must_use]
pub fn for_identity(identity: &Identity) -> Option<DriveDescription> {
    let known = [akd2g(), ax2000(), sigma7()];
    known.into_iter().find(|drive| drive.matches(identity))
}

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
    pub name: Cow<'static, str>,
    /// The vendor ID that the drive must show; `None` accepts any.
    pub vendor: Option<u32>,
    /// The product code that the drive must show; `None` accepts any.
    pub product: Option<u32>,
    /// The axes, in order.
    pub axes: Vec<AxisDescription>,
    /// The PDOs whose content is the drive's own, of all axes. Empty for a drive whose PDOs are all filled by the master. Of these
    /// and the free ones of the axes those are [chosen](choose) that hold what is wanted. `pdo_map::read_offered` reads them from a drive.
    pub fixed_pdos: Vec<FixedPdo>,
    /// What a mapping may hold at most.
    pub limits: MappingLimits,
    /// What its error codes mean, beyond CiA 402: for the texts of its emergencies.
    pub error_texts: ErrorTexts,
    /// How its Profile Position mode behaves.
    pub traits: Traits,
    /// The synchronisation types of outputs and inputs (1C32h:1, 1C33h:1) that it has by default, where its documents name them. A drive
    /// whose clock is not used gets them in place of SYNC0 of an earlier program.
    pub sync_types: [Option<u16>; 2],
}

impl DriveDescription {
    /// Whether a drive with this identity is one of those described.
    #[must_use]
    pub fn matches(&self, identity: &Identity) -> bool {
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

    /// The same drive with `axes` axes (1 to 8) like its first. Their objects are at the offsets of [`AxisOffset::of_axis`]. Their
    /// PDOs are `pdo_increment` above each other (10h as ETG.6010 lays them out; 1 with some two-axis drives). Fixed PDOs of
    /// further axes are not added.
    #[must_use]
    pub fn with_axes(mut self, axes: u8, pdo_increment: u16) -> Self {
        self.axes.truncate(1);
        let Some(first) = self.axes.first().cloned() else {
            return self;
        };
        for axis in 2..=axes.min(8) {
            let increment = pdo_increment.saturating_mul(u16::from(axis) - 1);
            let moved = |pdos: &[u16]| {
                let moved = pdos.iter().map(|pdo| pdo.saturating_add(increment));
                moved.collect()
            };
            self.axes.push(AxisDescription {
                offset: AxisOffset::of_axis(axis),
                rx_pdos: moved(&first.rx_pdos),
                tx_pdos: moved(&first.tx_pdos),
                ..first.clone()
            });
        }
        self
    }

    /// The mapping of all axes that is used where a program declares none.
    ///
    /// # Errors
    /// [`MappingError`] if the description asks for more than its limits, or for an object twice.
    pub fn default_mapping(&self) -> Result<Mapping, MappingError> {
        self.mapping_with(self.axes.iter().map(|_| (&[][..], &[][..])))
    }

    /// The mapping of as many axes as `further` has elements, each with further outputs and inputs of that axis.
    pub(crate) fn mapping_with<'a>(
        &self,
        further: impl IntoIterator<Item = (&'a [FurtherObject], &'a [FurtherObject])>,
    ) -> Result<Mapping, MappingError> {
        let mut demands = Vec::new();
        for (axis, (outputs, inputs)) in self.axes.iter().zip(further) {
            let sides = [
                (Direction::Outputs, &axis.outputs, outputs, &axis.rx_pdos),
                (Direction::Inputs, &axis.inputs, inputs, &axis.tx_pdos),
            ];
            for (direction, own, further, free) in sides {
                let own = own.iter().map(|object| (object, is_needed(object)));
                let further = further
                    .iter()
                    .map(|further| (&further.object, further.required));
                demands.extend(own.chain(further).map(|(object, required)| Demand {
                    direction,
                    object: object.offset(axis.offset),
                    required,
                    free,
                }));
            }
        }
        choose(&demands, &self.fixed_pdos, &self.limits)
    }
}

/// An object that a program maps beside those of the description.
#[derive(Debug, Clone)]
pub(crate) struct FurtherObject {
    pub object: AnyObject,
    /// Without it there is no mapping; others are left out where no PDO that can be assigned holds them.
    pub required: bool,
}

#[cfg(feature = "std")]
impl FurtherObject {
    pub fn required(object: impl Into<AnyObject>) -> Self {
        Self {
            object: object.into(),
            required: true,
        }
    }

    pub fn if_there(object: impl Into<AnyObject>) -> Self {
        Self {
            object: object.into(),
            required: false,
        }
    }
}

/// Whether an axis cannot be moved without this object in its process data.
fn is_needed(object: &AnyObject) -> bool {
    [
        obj::CONTROLWORD.address(),
        obj::TARGET_POSITION.address(),
        obj::STATUSWORD.address(),
        obj::POSITION_ACTUAL.address(),
    ]
    .contains(&object.address())
}

/// One axis of a drive.
///
/// ```
/// use servocrab::{coe::obj, drives::{AxisDescription, DriveDescription, generic}};
/// let mut axis = AxisDescription::profile_position(1, 0x1600, 0x1A00);
/// axis.inputs.push(obj::DIGITAL_INPUTS.into());
/// let drive = DriveDescription { axes: vec![axis], ..generic() };
/// assert_eq!(drive.default_mapping()?.layout().input_bytes(), 11 + 4);
/// # Ok::<(), servocrab::pdo_map::MappingError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AxisDescription {
    /// How far its objects lie above those of the first axis.
    pub offset: AxisOffset,
    /// The RxPDOs that are given to it to be filled, in this order; empty where all are of a fixed content.
    pub rx_pdos: Vec<u16>,
    /// The TxPDOs that are given to it to be filled, in this order; empty where all are of a fixed content.
    pub tx_pdos: Vec<u16>,
    /// What the master writes every cycle, as objects of the first axis. Where the PDOs are fixed and none that can be assigned
    /// holds one of them, it is left out, but for 6040h and 607Ah.
    pub outputs: Vec<AnyObject>,
    /// What the master reads every cycle, as objects of the first axis. Left out as outputs are, but for 6041h and 6064h.
    pub inputs: Vec<AnyObject>,
}

impl AxisDescription {
    /// Axis `axis`, counted from 1, with the usual offsets and the objects that Profile Position needs.
    #[must_use]
    pub fn profile_position(axis: u8, rx_pdo: u16, tx_pdo: u16) -> Self {
        Self {
            offset: AxisOffset::of_axis(axis),
            rx_pdos: alloc::vec![rx_pdo],
            tx_pdos: alloc::vec![tx_pdo],
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
