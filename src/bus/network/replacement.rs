//! The way of a drive into OP that stands in place of another one: accepted, given the alias and the parameters of the other one, and then
//! brought up as that one would be.
//!
//! Nothing is written before the drive is accepted. From then on it is out of OP until the last step is done, and each step can be done
//! again. Only after the last one it is the drive of its place.

use smol::channel::Sender;

use super::recovery::{Member, Recovery};
use crate::{
    axis::Reattach,
    bus::{
        device::{Device, DeviceKind, progress::StepDone},
        error::{
            AlState, AtStep, BringUpStep, DriveFault, NetworkError, OfDevice, RegisterError,
            StepError,
        },
        event::Recovered,
        expected::{DevicePlace, LineVerdict, Present},
        line::{self, Found},
        requests::eeprom::{self, WholeEeprom},
        watch::note_state,
    },
    coe::DriveId,
    parameters::{self, MemoryFault, ParameterSet, Progress},
    sii::{Identity, SiiImage},
};

impl Recovery {
    /// Takes what stands there for the device of this place.
    pub async fn replace(
        &self,
        place: usize,
        member: &Member,
        device: &mut Device,
        (serial, backup): &(u32, ParameterSet),
        steps: Sender<StepDone>,
    ) -> Result<Recovered, NetworkError> {
        let id = device.found.id.clone();
        let of_its_kind = backup.check(id.identity).at(BringUpStep::Restore);
        of_its_kind.of(&id)?;
        let (position, from) = match self.status(device.found.station).await {
            Ok(status) => {
                note_state(&self.context, &self.control, place, &member.id, status);
                let is_back =
                    status.state == AlState::Op && status.error.is_none() && !member.is_half_way();
                if is_back {
                    // It is the one of this place, and is not disturbed to be asked.
                    let numbers = Vec::new();
                    accept(device, Present { id, numbers }, *serial)?;
                    return self.recover(place, member, device, steps).await;
                }
                (id.position, Some(status))
            }
            Err(RegisterError::NotAnswered) => {
                let accepted = Some(*serial);
                (self.find(place, member, device, accepted).await?, None)
            }
            Err(error) => return Err(error).at(BringUpStep::Identity).of(&id),
        };
        let mut newcomer = device.clone();
        newcomer.found = self.accepted(place, member, device, *serial).await?;
        if let DeviceKind::Drive(drive) = &mut newcomer.kind {
            drive.forget_positions();
        }
        let id = newcomer.found.id.clone();
        if let DevicePlace::Alias(alias) = device.place {
            let written = self.write_alias(member, &newcomer.found, alias).await;
            written.of(&id)?;
        }
        self.bring_up(place, member, &mut newcomer, Some(backup), steps)
            .await?;
        let place = usize::from(id.position);
        if let Some(known) = self.line.borrow_mut().devices.get_mut(place) {
            *known = id;
        }
        *device = newcomer;
        Ok(Recovered::BroughtUp { position, from })
    }

    /// What has the station address of the device, in INIT, if it is accepted.
    async fn accepted(
        &self,
        place: usize,
        member: &Member,
        device: &Device,
        serial: u32,
    ) -> Result<Found, NetworkError> {
        let registers = &self.context.registers;
        let Found { station, id, .. } = &device.found;
        // Nobody enables an axis of it meanwhile.
        self.reattach(place, |_| Reattach::Unknown);
        let present = device.present(registers).await;
        // Whatever came of it: the device may need it.
        let given = eeprom::give_away(registers, *station).await;
        let present = present.of(id)?;
        given.at(BringUpStep::Sii).of(id)?;
        let id = &DriveId {
            identity: present.id.identity,
            ..id.clone()
        };
        accept(device, present, serial)?;
        member.begin_anew();
        self.axes.borrow_mut().forget(place);
        self.cut_off(place);
        let init = line::set_back(registers, *station).await;
        init.at(BringUpStep::State(AlState::Init)).of(id)?;
        let found = device.found.successor(registers).await.of(id)?;
        let (id, numbers) = (found.id.clone(), Vec::new());
        accept(device, Present { id, numbers }, serial)?;
        let mailboxes = [&device.found, &found].map(|found| found.sii.mailbox);
        if let [Some(expected), Some(got)] = mailboxes
            && expected != got
        {
            let other = Err(DriveFault::OtherMailbox { expected, got });
            return other.at(BringUpStep::Sii).of(&found.id);
        }
        Ok(found)
    }

    /// Writes the alias to the EEPROM of a drive in INIT, where that has not got it. What an earlier attempt began is brought to its end.
    async fn write_alias(
        &self,
        member: &Member,
        found: &Found,
        alias: u16,
    ) -> Result<(), StepError> {
        let step = BringUpStep::Alias;
        let eeprom = WholeEeprom::of(&self.context.registers, found.station).await;
        let eeprom = eeprom.at(step)?;
        let before = eeprom.read().await.at(step)?;
        let whole = SiiImage::new(before.as_slice());
        let was_valid = whole.is_ok();
        let begun = member.image.borrow().clone();
        let begun = begun.filter(|image| image.identity() == found.id.identity);
        let image = match (whole, begun) {
            (Ok(whole), _) => whole.with_alias(alias),
            (Err(_), Some(begun)) => begun,
            (Err(error), None) => return Err(error).at(step),
        };
        *member.image.borrow_mut() = Some(image.clone());
        eeprom.write(&before, &image).await.at(step)?;
        *member.image.borrow_mut() = None;
        let got = eeprom.reload().await.at(step)?;
        // One that had no valid image when it was switched on has not come to life.
        if got != alias || !was_valid {
            return Err(DriveFault::NotInForce { alias, got }).at(step);
        }
        Ok(())
    }

    /// In PREOP: the drive gets the parameters, and stores them.
    pub async fn restore(device: &Device, backup: &ParameterSet) -> Result<(), StepError> {
        let sdo = device.mailbox.as_ref().map(|mailbox| &mailbox.sdo);
        let sdo = sdo.ok_or(DriveFault::NoMailbox).at(BringUpStep::Restore)?;
        let restored = backup.restore(sdo, Progress::none()).await;
        restored
            .map_err(|error| error.fault)
            .at(BringUpStep::Restore)?;
        device.done(BringUpStep::Restore);
        let stored = match backup.parameters.as_slice() {
            [] => Ok(()),
            _ => parameters::store(sdo).await.map_err(|error| error.fault),
        };
        match stored {
            Err(MemoryFault::NotOnCommand {
                by_itself: true, ..
            }) => {}
            stored => stored.at(BringUpStep::Store)?,
        }
        device.done(BringUpStep::Store);
        Ok(())
    }
}

impl Member {
    /// Whether an EEPROM has a part of an image, and no valid one. Its writing is not given up.
    pub fn is_being_written(&self) -> bool {
        self.image.borrow().is_some()
    }
}

/// Whether this may stand in place of the device.
fn accept(device: &Device, present: Present, serial: u32) -> Result<(), NetworkError> {
    let known = &device.found.id;
    let (old, new) = (known.identity, present.id.identity);
    let revision = old.revision;
    let wanted = Identity { serial, ..old };
    if (Identity { revision, ..new }) != wanted {
        let wanted = DriveId {
            identity: wanted,
            ..known.clone()
        };
        let (present, verdict) = (Some(present), LineVerdict::Different);
        return Err(line::mismatch(device.place, &wanted, present, verdict));
    }
    if new.revision < revision {
        let (expected, got) = (revision, new.revision);
        let fault = DriveFault::OlderRevision { expected, got };
        return Err(fault).at(BringUpStep::Identity).of(&present.id);
    }
    Ok(())
}
