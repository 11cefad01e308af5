//! Typed fields of a drive's process data beside the ones that the axis itself uses: any object that is mapped.

use core::{fmt, marker::PhantomData};
use std::sync::Arc;

use crate::{
    coe::{Number, Object, ObjectAddress, Readable, Writable},
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
    /// what the axis itself writes (6040h, 6060h, 607Ah, 6081h to 6084h, 6086h, 6098h to 609Ah, 60FFh, of any axis).
    pub fn output<T: Number, A: Writable>(
        &self,
        object: Object<T, A>,
    ) -> Result<OutputField<T>, AxisError> {
        let shared = &self.handles.shared;
        let setup = &shared.setup;
        let object = object.offset(setup.offset);
        let address = object.address();
        if is_owned(address) {
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

    /// The value that was set last, by whichever field of this object of this axis; none before the first.
    #[must_use]
    pub fn get(&self) -> Option<T> {
        self.shared.outputs.get(self.cell).map(T::from_raw)
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

/// Whether an axis core writes the object: its own or another axis'. Axes lie 0800h apart in 6000h to 9FFFh.
fn is_owned(object: ObjectAddress) -> bool {
    let in_profile = (0x6000..=0x9FFF).contains(&object.index);
    let first_axis = object.index & 0x07FF;
    in_profile
        && matches!(
            first_axis,
            0x40 | 0x60 | 0x7A | 0x81 | 0x82 | 0x83 | 0x84 | 0x86 | 0x98 | 0x99 | 0x9A | 0xFF
        )
}
