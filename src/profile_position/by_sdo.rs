//! Profile parameters that are not in the process data: written by SDO before a move, and set back for a move that leaves
//! them out.

use core::sync::atomic::Ordering;

use crate::{
    axis::{AxisError, AxisFields, Claim, Handles},
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
    ends_in_motion: bool,
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
        this.ends_in_motion =
            fields.end_velocity.is_none() && parameters.end_velocity.is_some_and(|end| end != 0);
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

    /// Makes the drive's objects what this motion wants, which has claimed them.
    pub(crate) async fn write(
        self,
        handles: &Handles,
        claim: &mut Claim<'_>,
    ) -> Result<(), AxisError> {
        let changed = &handles.parameters_changed;
        // Said before, and taken back when it is known: a caller may give up in between.
        changed.store(true, Ordering::Release);
        let end_velocity = &handles.ends_in_motion;
        end_velocity.fetch_or(self.ends_in_motion, Ordering::AcqRel);
        claim.written.begin(handles.shared.attached());
        for object in self.left_out {
            // What a move leaves out is again what the drive held.
            if let Some(before) = claim.written.to_set_back(object) {
                handles.write_parameter(object, before).await?;
                claim.written.is_set_back(object);
                claim.step();
            }
        }
        for (object, value) in self.writes {
            if !claim.written.will_change(object) {
                let before = handles.read_parameter(object).await?;
                claim.written.note(object, before);
                claim.step();
            }
            handles.write_parameter(object, value).await?;
            claim.step();
        }
        changed.store(claim.written.any_changed(), Ordering::Release);
        Ok(())
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

    /// Forgets what was written to a drive that has been attached anew since.
    fn begin(&mut self, attached: u32) {
        if core::mem::replace(&mut self.attached, attached) != attached {
            self.written.clear();
        }
    }

    /// What the drive held in this object, where it may hold something else now.
    fn to_set_back(&self, object: ObjectAddress) -> Option<Vec<u8>> {
        let mut changed = self.written.iter().filter(|written| written.changed);
        changed
            .find(|written| written.object == object)
            .map(|written| written.before.clone())
    }

    fn is_set_back(&mut self, object: ObjectAddress) {
        for written in &mut self.written {
            written.changed &= written.object != object;
        }
    }

    /// This object is about to be written. Whether it is known what the drive held there.
    fn will_change(&mut self, object: ObjectAddress) -> bool {
        let known = self
            .written
            .iter_mut()
            .find(|written| written.object == object);
        known.map(|written| written.changed = true).is_some()
    }

    fn note(&mut self, object: ObjectAddress, before: Vec<u8>) {
        self.written.push(Written {
            object,
            before,
            changed: true,
        });
    }
}
