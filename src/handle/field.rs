//! Typed fields of a drive's process data beside the ones that the axis itself uses: any object that is mapped.

use core::{fmt, marker::PhantomData};
use std::sync::Arc;

use crate::{
    coe::{AxisOffset, Number, Object, ObjectAddress, Readable, Writable, obj},
    ds402::{DigitalInput, DigitalOutput},
    pdo_map::{self, Direction, LayoutError},
    units::AxisUnit,
};

use super::{Axis, AxisError, AxisErrorKind, Sampled, Stale, shared::Shared};

/// A mapped object that the drive sends.
pub struct InputField<T> {
    shared: Arc<Shared>,
    field: pdo_map::Field<T>,
}

/// A mapped object that the program writes.
pub struct OutputField<T> {
    shared: Arc<Shared>,
    cell: usize,
    kind: PhantomData<fn(T)>,
}

impl<U: AxisUnit> Axis<U> {
    /// An object of the first axis' numbering, read from the process data of this axis.
    ///
    /// # Errors
    /// [`AxisErrorKind::Field`] if the drive does not send it, or with another length.
    pub fn input<T: Number, A: Readable>(
        &self,
        object: Object<T, A>,
    ) -> Result<InputField<T>, AxisError> {
        let shared = &self.handles.shared;
        InputField::of(shared, object).map_err(|error| shared.error(AxisErrorKind::Field(error)))
    }

    /// An object of the first axis' numbering, written through the process data of this axis. Until it is set it is there what
    /// [`AxisConfig::map_output`](crate::AxisConfig::map_output) says, in a [`Network`](crate::Network): what the drive held at the
    /// start, with the brake bit of 60FEh:1 set.
    ///
    /// # Errors
    /// [`AxisErrorKind::Field`] if it is not in the drive's outputs, or with another length. [`AxisErrorKind::OwnedByAxis`] for
    /// what the axis itself writes (6040h, 6060h, 607Ah, 6081h to 6084h, 6086h, 6098h to 609Ah, 60FFh, of any axis), and for the digital outputs
    /// 60FEh:1 of another axis.
    pub fn output<T: Number, A: Writable>(
        &self,
        object: Object<T, A>,
    ) -> Result<OutputField<T>, AxisError> {
        let shared = &self.handles.shared;
        let setup = &shared.setup;
        let object = object.offset(setup.offset);
        let address = object.address();
        if is_owned(address, setup.offset) {
            let kind = AxisErrorKind::OwnedByAxis { object: address };
            return Err(shared.error(kind));
        }
        let error = |error| shared.error(AxisErrorKind::Field(error));
        setup.layout.output(object).map_err(error)?;
        let not_mapped = || LayoutError::NotMapped {
            object: address,
            name: object.name(),
            direction: Direction::Outputs,
        };
        Ok(OutputField {
            cell: shared
                .outputs
                .place_of(address)
                .ok_or_else(|| error(not_mapped()))?,
            shared: Arc::clone(shared),
            kind: PhantomData,
        })
    }
}

impl<T: Number> InputField<T> {
    /// An object of the first axis' numbering, where the drive sends it for this axis.
    pub(super) fn of<A: Readable>(
        shared: &Arc<Shared>,
        object: Object<T, A>,
    ) -> Result<Self, LayoutError> {
        let setup = &shared.setup;
        Ok(Self {
            field: setup.layout.input(object.offset(setup.offset))?,
            shared: Arc::clone(shared),
        })
    }

    /// The value that the last cycle brought.
    ///
    /// # Errors
    /// [`Stale`] if it brought none: the drive is silent, or a frame was lost. [`last`](Self::last) has the one before.
    pub fn get(&self) -> Result<T, Stale> {
        match self.read() {
            (Some(0), value) => Ok(value),
            (age, _) => Err(Stale { age }),
        }
    }

    /// The value that came last, with its age; none if there never was one.
    #[must_use]
    pub fn last(&self) -> Option<Sampled<T>> {
        let (age, value) = self.read();
        Some(Sampled { value, age: age? })
    }

    fn read(&self) -> (Option<u32>, T) {
        self.shared.status.sample(|snapshot, inputs| {
            let age = if snapshot.answered {
                Some(0)
            } else if self.shared.is_closed() {
                Some(u32::MAX)
            } else {
                // As many cycles without inputs as there were: none has brought any.
                let has_come = snapshot.cycle > u64::from(snapshot.age);
                has_come.then_some(snapshot.age.max(1))
            };
            (age, inputs.value(self.field))
        })
    }
}

impl<T: Number> OutputField<T> {
    /// Sends this value from the next cycle on.
    pub fn set(&self, value: T) {
        self.shared.write_output(self.cell, value.to_raw());
    }

    /// The value that was set last, by whichever field of this object of this axis; none before the first, and while only single bits
    /// were set ([`Axis::digital_output`]).
    #[must_use]
    pub fn get(&self) -> Option<T> {
        self.bits(mask_of(T::BITS)).map(T::from_raw)
    }

    /// Sends these bits from the next cycle on, and the others as they are.
    fn set_bits(&self, mask: u32, on: bool) {
        let bits = if on { mask } else { 0 };
        self.shared.change_output(self.cell, mask, bits);
    }

    /// What these bits were set to last; none if they were not.
    fn bits(&self, mask: u32) -> Option<u32> {
        self.shared.outputs.get(self.cell, mask)
    }

    /// Whether one of these bits is the axis' own.
    fn is_owned(&self, mask: u32) -> bool {
        self.shared.outputs.owned(self.cell) & mask != 0
    }
}

/// So many bits, the lowest ones.
const fn mask_of(bits: u8) -> u32 {
    match 1u32.checked_shl(bits as u32) {
        Some(above) => above - 1,
        None => u32::MAX,
    }
}

impl<T> Clone for InputField<T> {
    fn clone(&self) -> Self {
        Self {
            shared: Arc::clone(&self.shared),
            ..*self
        }
    }
}

impl<T> Clone for OutputField<T> {
    fn clone(&self) -> Self {
        Self {
            shared: Arc::clone(&self.shared),
            ..*self
        }
    }
}

impl<T: Number + fmt::Debug> fmt::Debug for InputField<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("InputField").field(&self.last()).finish()
    }
}

impl<T: Number + fmt::Debug> fmt::Debug for OutputField<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("OutputField").field(&self.get()).finish()
    }
}

// Single bits by name: 60FDh and 60FEh:1.

/// A digital input of an axis.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{AxisConfig, DriveConfig, Network, coe::obj, drives, link::Wire};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::generic());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// use servocrab::ds402::DigitalInput;
/// let x = AxisConfig::new("x").map_input(obj::DIGITAL_INPUTS);
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, DriveConfig::new(drives::generic()).axis(x)).start().await?;
/// let at_end = net.axis("x")?.digital_input(DigitalInput::PositiveLimitSwitch)?;
/// assert!(!at_end.get()?);
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Clone)]
pub struct InputBit {
    field: InputField<u32>,
    mask: u32,
}

/// A digital output of an axis. Where the mask 60FEh:2 does not enable the bit, the drive ignores it.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # use servocrab::{AxisConfig, DriveConfig, Network, coe::obj, drives, link::Wire, parameters::StartUpWrite};
/// # let mut segment = servocrab_sim::Segment::new().with(servocrab_sim::personality::generic());
/// # let wire = Wire::new(move |frame, now| segment.process(frame, now));
/// use servocrab::ds402::DigitalOutput;
/// let x = AxisConfig::new("x").map_output(obj::DIGITAL_OUTPUTS);
/// let drive = DriveConfig::new(drives::generic())
///     .axis(x)
///     .start_up(StartUpWrite::new(obj::DIGITAL_OUTPUTS_MASK, 0x0001_0000));
/// # smol::block_on(async {
/// # let net = Network::builder().link(wire).drive(0, drive).start().await?;
/// let gripper = net.axis("x")?.digital_output(DigitalOutput::Bit(16))?;
/// gripper.set(true);
/// assert_eq!(gripper.get(), Some(true));
/// # net.shutdown().await?;
/// # Ok(())
/// # })
/// # }
/// ```
#[derive(Clone)]
pub struct OutputBit {
    field: OutputField<u32>,
    mask: u32,
}

impl<U: AxisUnit> Axis<U> {
    /// A digital input of this axis, from 60FDh in the process data. PLCopen calls it `MC_ReadDigitalInput`.
    ///
    /// # Errors
    /// [`AxisErrorKind::Field`] if the drive does not send 60FDh: map it by
    /// [`AxisConfig::map_input`](crate::AxisConfig::map_input). [`AxisErrorKind::NoBit`] for a number above 31.
    pub fn digital_input(&self, input: DigitalInput) -> Result<InputBit, AxisError> {
        let mask = input.mask().ok_or_else(|| self.no_bit())?;
        let field = self.input(obj::DIGITAL_INPUTS)?;
        Ok(InputBit { field, mask })
    }

    /// A digital output of this axis, in 60FEh:1 in the process data. PLCopen calls it `MC_WriteDigitalOutput`. Other bits stay as they are.
    /// Until it is set, it is what [`AxisConfig::map_output`](crate::AxisConfig::map_output) says.
    ///
    /// # Errors
    /// [`AxisErrorKind::Field`] if 60FEh:1 is not in the drive's outputs: map it by
    /// [`AxisConfig::map_output`](crate::AxisConfig::map_output). [`AxisErrorKind::OwnedByAxis`] for the output of its
    /// [`Brake`](crate::axis::Brake). [`AxisErrorKind::NoBit`] for a number above 31.
    pub fn digital_output(&self, output: DigitalOutput) -> Result<OutputBit, AxisError> {
        let mask = output.mask().ok_or_else(|| self.no_bit())?;
        let field = self.output(obj::DIGITAL_OUTPUTS)?;
        if field.is_owned(mask) {
            let object = self.handles.of_axis(obj::DIGITAL_OUTPUTS.address());
            let kind = AxisErrorKind::OwnedByAxis { object };
            return Err(self.handles.shared.error(kind));
        }
        Ok(OutputBit { field, mask })
    }

    fn no_bit(&self) -> AxisError {
        self.handles.shared.error(AxisErrorKind::NoBit)
    }
}

impl InputBit {
    /// Whether the last cycle has brought it as 1.
    ///
    /// # Errors
    /// [`Stale`] if that cycle brought no inputs. [`last`](Self::last) has the ones before.
    pub fn get(&self) -> Result<bool, Stale> {
        Ok(self.field.get()? & self.mask != 0)
    }

    /// What came last, with its age; none if there never was one.
    #[must_use]
    pub fn last(&self) -> Option<Sampled<bool>> {
        let Sampled { value, age } = self.field.last()?;
        let value = value & self.mask != 0;
        Some(Sampled { value, age })
    }
}

impl OutputBit {
    /// Sends this from the next cycle on.
    pub fn set(&self, on: bool) {
        self.field.set_bits(self.mask, on);
    }

    /// What it was set to last, here or by a field of the whole object; none before the first.
    #[must_use]
    pub fn get(&self) -> Option<bool> {
        self.field.bits(self.mask).map(|bits| bits != 0)
    }
}

impl fmt::Debug for InputBit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("InputBit").field(&self.last()).finish()
    }
}

impl fmt::Debug for OutputBit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("OutputBit").field(&self.get()).finish()
    }
}

/// Whether an axis core writes the object: that of this axis, or another one's. Axes lie 0800h apart in 6000h to 9FFFh.
fn is_owned(object: ObjectAddress, axis: AxisOffset) -> bool {
    let in_profile = (0x6000..=0x9FFF).contains(&object.index);
    in_profile
        && match object.index & 0x07FF {
            0x40 | 0x60 | 0x7A | 0x81 | 0x82 | 0x83 | 0x84 | 0x86 | 0x98 | 0x99 | 0x9A | 0xFF => {
                true
            }
            // One bit may be the brake of the axis. Its own is masked.
            0xFE => {
                object.subindex == 1 && object.index != axis.apply(obj::DIGITAL_OUTPUTS.index())
            }
            _ => false,
        }
}
