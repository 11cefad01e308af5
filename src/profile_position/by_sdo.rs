//! Profile parameters that are not in the process data: written by SDO before a move, and set back for a move that leaves
//! them out.

use core::sync::atomic::Ordering;

use smol::lock::MutexGuard;

use crate::{
    axis::{AxisError, AxisFields, Handles},
    coe::{Number, Object, ObjectAddress, Writable, obj},
};

use super::Parameters;

/// What a move needs written by SDO.
#[derive(Debug, Default)]
pub(crate) struct BySdo {
    /// Of the move's parameters.
    writes: Vec<(ObjectAddress, Vec<u8>)>,
    /// The objects that it leaves out.
    left_out: Vec<ObjectAddress>,
    /// A speed of zero.
    pub(crate) zero: Option<&'static str>,
}

/// The objects that moves of an axis have written by SDO.
#[derive(Debug, Default)]
pub(crate) struct WrittenParameters {
    written: Vec<Written>,
    /// How often the drive had been attached anew by then: it has forgotten what was written before.
    attached: u32,
}

#[derive(Debug)]
struct Written {
    object: ObjectAddress,
    /// What the drive held before the first move wrote it.
    before: Vec<u8>,
    /// Whether the drive may hold something else now.
    changed: bool,
}

impl BySdo {
    /// Takes those parameters out of a move that do not go into the process data.
    pub(crate) fn take(fields: &AxisFields, parameters: &mut Parameters) -> Self {
        let mut this = Self::default();
        this.speed(
            fields.velocity.is_some(),
            &mut parameters.velocity,
            obj::PROFILE_VELOCITY,
            "profile velocity 6081h",
        );
        this.speed(
            fields.acceleration.is_some(),
            &mut parameters.acceleration,
            obj::PROFILE_ACCELERATION,
            "profile acceleration 6083h",
        );
        this.speed(
            fields.deceleration.is_some(),
            &mut parameters.deceleration,
            obj::PROFILE_DECELERATION,
            "profile deceleration 6084h",
        );
        this.other(
            fields.end_velocity.is_some(),
            &mut parameters.end_velocity,
            obj::END_VELOCITY,
        );
        this.other(
            fields.profile_type.is_some(),
            &mut parameters.profile_type,
            obj::MOTION_PROFILE_TYPE,
        );
        this
    }

    /// Whether the drive has to be told anything.
    pub(crate) fn is_needed(&self, handles: &Handles) -> bool {
        !self.writes.is_empty() || handles.parameters_changed.load(Ordering::Acquire)
    }

    /// Makes the drive's objects what this motion wants. The guard is to be held until the drive has taken it, so that no other
    /// motion's parameters come in between.
    pub(crate) async fn write(
        self,
        handles: &Handles,
    ) -> Result<MutexGuard<'_, WrittenParameters>, AxisError> {
        let mut written = handles.parameters_in_use.lock().await;
        let changed = &handles.parameters_changed;
        // Said before, and taken back when it is known: a caller may give up in between.
        changed.store(true, Ordering::Release);
        written.write(self, handles).await?;
        changed.store(written.any_changed(), Ordering::Release);
        Ok(written)
    }

    fn speed<A: Writable>(
        &mut self,
        mapped: bool,
        value: &mut Option<u32>,
        object: Object<u32, A>,
        name: &'static str,
    ) {
        if !mapped && *value == Some(0) {
            self.zero = Some(name);
        }
        self.other(mapped, value, object);
    }

    fn other<T: Number, A: Writable>(
        &mut self,
        mapped: bool,
        value: &mut Option<T>,
        object: Object<T, A>,
    ) {
        if mapped {
            return;
        }
        match value.take() {
            Some(value) => self.writes.push((object.address(), value.encode())),
            None => self.left_out.push(object.address()),
        }
    }
}

impl WrittenParameters {
    /// Whether the drive may hold a parameter of an earlier move.
    fn any_changed(&self) -> bool {
        self.written.iter().any(|written| written.changed)
    }

    /// Those that a move names are as it names them; those that it leaves out are again what the drive held.
    async fn write(&mut self, by_sdo: BySdo, handles: &Handles) -> Result<(), AxisError> {
        let attached = handles.shared.attached();
        if core::mem::replace(&mut self.attached, attached) != attached {
            self.written.clear();
        }
        for written in &mut self.written {
            if written.changed && by_sdo.left_out.contains(&written.object) {
                handles
                    .write_parameter(written.object, written.before.clone())
                    .await?;
                written.changed = false;
            }
        }
        for (object, value) in by_sdo.writes {
            match self
                .written
                .iter_mut()
                .find(|written| written.object == object)
            {
                Some(written) => written.changed = true,
                None => {
                    let before = handles.read_parameter(object).await?;
                    self.written.push(Written {
                        object,
                        before,
                        changed: true,
                    });
                }
            }
            handles.write_parameter(object, value).await?;
        }
        Ok(())
    }
}
