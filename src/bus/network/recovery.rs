//! The way of one device back into OP, while all others keep their cycles and their motions.
//!
//! Only the program asks for it. Before anything is done with the device its axes begin again: what they were asked for has ended,
//! and what goes out to them is that of an axis that is switched off.

use std::{
    cell::{Cell, RefCell},
    iter,
    rc::Rc,
    sync::Arc,
    time::Duration,
};

use smol::{
    channel::{Sender, unbounded},
    future::or,
    lock::Mutex,
};

use super::{axes::Axes, bring_up::EXCHANGE_LIMIT};
use crate::{
    axis::{CoreConfig, Reattach},
    bus::{
        clocks::{self, Clocks},
        cycle::{Answer, Cycle, DriveData, SeenState},
        device::{
            Device, SAFE_OP_LIMIT,
            io_port::Ports,
            progress::{Progress, StepDone},
        },
        error::{
            AlState, AlStatus, AtStep, BringUpStep, DriveFault, NetworkError, OfDevice,
            RegisterError, StepError,
        },
        event::Recovered,
        line::{self, Found, KnownLine},
        log::LogRecord,
        requests::{Context, eeprom, registers},
        watch::{Control, data_of, note_state},
    },
    coe::DriveId,
    esc,
    parameters::ParameterSet,
    sii::SiiImage,
};

/// Brings devices of the exchange back into OP.
pub(in crate::bus) struct Recovery {
    pub context: Context,
    pub control: Arc<Control>,
    pub period: Duration,
    pub axes: Rc<RefCell<Axes>>,
    pub ports: Rc<RefCell<Ports>>,
    /// All devices of the line, as they were numbered at the start; those that were replaced since as they are now.
    pub line: RefCell<KnownLine>,
    /// Its clocks, where they are used.
    pub clocks: Option<Rc<Clocks>>,
    /// In the order of the exchange.
    pub devices: Vec<Member>,
    /// Held by whoever looks for a device.
    pub search: Mutex<()>,
}

impl Recovery {
    /// Brings one back, or what was put there in place of it, unless whoever asked for it goes away.
    pub async fn serve(
        &self,
        place: usize,
        replacement: Option<(u32, ParameterSet)>,
        steps: Sender<StepDone>,
        reply: &Sender<Result<Recovered, NetworkError>>,
    ) {
        let Some(member) = self.devices.get(place) else {
            return;
        };
        if self.axes.borrow().is_absent(place) {
            let drive = DriveId::clone(&member.id);
            // Whoever has gone away by now misses it.
            let _ = reply.try_send(Err(NetworkError::Absent(drive)));
            return;
        }
        let mut device = member.device.lock().await;
        let recovery = async {
            Some(match &replacement {
                Some(by) => self.replace(place, member, &mut device, by, steps).await,
                None => self.recover(place, member, &mut device, steps).await,
            })
        };
        let given_up = async {
            reply.closed().await;
            while member.is_being_written() {
                self.context.time.sleep(self.period).await;
            }
            None
        };
        let result = or(given_up, recovery).await;
        if !matches!(result, Some(Ok(_))) {
            self.leave(place, member, &device.found).await;
        }
        let note = match &result {
            Some(Ok(recovered)) => LogRecord::Recovered(Arc::clone(&member.id), *recovered),
            Some(Err(error)) => {
                LogRecord::NotRecovered(Arc::clone(&member.id), Some(error.to_string()))
            }
            None => LogRecord::NotRecovered(Arc::clone(&member.id), None),
        };
        self.context.log.record(self.context.time.now(), note);
        if let Some(result) = result {
            // Whoever has gone away by now misses it.
            let _ = reply.try_send(result);
        }
    }

    pub async fn recover(
        &self,
        place: usize,
        member: &Member,
        device: &mut Device,
        steps: Sender<StepDone>,
    ) -> Result<Recovered, NetworkError> {
        let from = match self.status(device.found.station).await {
            Ok(status) => status,
            Err(RegisterError::NotAnswered) => {
                let position = self.find(place, member, device, None).await?;
                self.bring_up(place, member, device, None, steps).await?;
                let from = None;
                return Ok(Recovered::BroughtUp { position, from });
            }
            Err(error) => {
                return Err(error).at(BringUpStep::Identity).of(&device.found.id);
            }
        };
        note_state(&self.context, &self.control, place, &member.id, from);
        let half_way = member.is_half_way();
        match from.state {
            AlState::Op if from.error.is_none() && !half_way => {
                let is_served = self.until(|this| this.is_served(place));
                is_served.await.of(&device.found.id)?;
                if member.is_reference {
                    self.join_clocks(member, device).await?;
                }
                // An attempt before may have failed while it was cut off.
                self.ports.borrow_mut().release(place);
                self.axes.borrow_mut().recall_homing(place);
                Ok(Recovered::WasInOp)
            }
            AlState::Op | AlState::SafeOp
                if !half_way && self.is_the_same(place, device).await? =>
            {
                self.return_to_op(place, member, device, steps).await?;
                Ok(Recovered::FromSafeOp { from })
            }
            _ => {
                self.bring_up(place, member, device, None, steps).await?;
                Ok(Recovered::BroughtUp {
                    position: device.found.id.position,
                    from: Some(from),
                })
            }
        }
    }

    /// The AL status of whoever has this station address.
    pub async fn status(&self, station: u16) -> Result<AlStatus, RegisterError> {
        match registers::status(&self.context.registers, station).await {
            // What follows ends what a device does that runs: one frame is no proof.
            Err(RegisterError::NotAnswered) => {
                registers::status(&self.context.registers, station).await
            }
            seen => seen,
        }
    }

    /// Gives it its station address again, wherever it is in the line now: it, or what is accepted in place of it.
    pub async fn find(
        &self,
        place: usize,
        member: &Member,
        device: &Device,
        accepted: Option<u32>,
    ) -> Result<u16, NetworkError> {
        let at_start = &device.found.id;
        self.cut_off(place);
        let _searching = self.search.lock().await;
        let position = self.address(at_start, accepted).await?;
        let has_clock = member.is_reference || device.clocks().is_some();
        if has_clock && position != at_start.position {
            return Err(DriveFault::ClockOfRunningLine)
                .at(BringUpStep::Clock)
                .of(at_start);
        }
        Ok(position)
    }

    /// A device of an optional group comes into the line: it has its address, and is in INIT.
    pub async fn join(&self, place: usize) -> Result<(), NetworkError> {
        let Some(member) = self.devices.get(place) else {
            return Ok(());
        };
        let mut device = member.device.lock().await;
        let found = device.found.meet(&self.context).await?;
        let before = device.clone();
        device.join(found);
        let (steps, _) = unbounded();
        let joined = self.bring_up(place, member, &mut device, None, steps).await;
        if joined.is_err() {
            *device = before;
        }
        joined
    }

    /// A device of an optional group is not in the line, or not any more.
    pub fn take_out(&self, place: usize) {
        self.cut_off(place);
        let mut axes = self.axes.borrow_mut();
        axes.forget(place);
        axes.set_absent(place, true);
        if let Some(member) = self.devices.get(place) {
            member.phase.set(ReturnPhase::None);
        }
    }

    /// As at the start, from INIT. Parameters of a backup are its own before anything else is written to it.
    pub async fn bring_up(
        &self,
        place: usize,
        member: &Member,
        device: &mut Device,
        backup: Option<&ParameterSet>,
        steps: Sender<StepDone>,
    ) -> Result<(), NetworkError> {
        member.begin_anew();
        self.axes.borrow_mut().forget(place);
        self.cut_off(place);
        device.enter_pre_op(&self.context).await?;
        self.take_ports(device).await?;
        self.set_clock(member, device).await?;
        // It stays as it was at the start if this fails.
        let mut anew = device.clone();
        anew.progress = Rc::new(match device.as_drive() {
            Some(_) if backup.is_some() => Progress::of_a_replacement(&self.context, steps),
            Some(_) => Progress::new(&self.context, steps, 1, 0),
            None => Progress::new(&self.context, steps, 0, 1),
        });
        if let Some(backup) = backup {
            let restored = Self::restore(&anew, backup).await;
            restored.of(&anew.found.id)?;
        }
        self.set_up(place, member, device, &mut anew).await?;
        *device = anew;
        Ok(())
    }

    /// Where devices come and go, its ports open and close as those of all others.
    async fn take_ports(&self, device: &Device) -> Result<(), NetworkError> {
        if self.line.borrow().optional.is_empty() {
            return Ok(());
        }
        let Found { station, id, .. } = &device.found;
        let registers = &self.context.registers;
        let set = registers.write(*station, esc::PORTS, &[esc::AUTO_CLOSE]);
        set.await.at(BringUpStep::Identity).of(id)
    }

    /// From PREOP into OP, with the process data that it had at the start.
    async fn set_up(
        &self,
        place: usize,
        member: &Member,
        before: &Device,
        device: &mut Device,
    ) -> Result<(), NetworkError> {
        let steps = async {
            device.configure(&self.context).await?;
            // Others would lie where those of other devices are.
            same_process_data(before, device)?;
            device.enter_safe_op(&self.context).await?;
            same_process_data(before, device)?;
            device.read_as_it_is_now(&self.context, before).await
        };
        steps.await.of(&before.found.id)?;
        // It is set up, and not yet in OP.
        self.put_back(place, |data| data.seen = SeenState::LeftOp);
        if device.clocks().is_some() {
            self.context.time.sleep(clocks::settling(self.period)).await;
        }
        self.bring_into_op(place, member, device, Reattach::Anew)
            .await?;
        device.done(BringUpStep::State(AlState::Op));
        Ok(())
    }

    /// Whether the device that has this station address is the one of the start. One that was plugged in with its power on may have it
    /// from another line, and process data as well.
    async fn is_the_same(&self, place: usize, device: &Device) -> Result<bool, NetworkError> {
        self.reattach(place, |_| Reattach::Unknown);
        let (registers, Found { station, id, .. }) = (&self.context.registers, &device.found);
        let present = device.present(registers).await;
        // Whatever came of it: the device may need it.
        let given = eeprom::give_away(registers, *station).await;
        let present = present.of(id)?;
        given.at(BringUpStep::Sii).of(id)?;
        Ok(device.is(&present))
    }

    /// From SAFEOP, with the error that has led there.
    async fn return_to_op(
        &self,
        place: usize,
        member: &Member,
        device: &mut Device,
        steps: Sender<StepDone>,
    ) -> Result<(), NetworkError> {
        let safe_op = BringUpStep::State(AlState::SafeOp);
        member.phase.set(ReturnPhase::FromSafeOp);
        self.reattach(place, |_| Reattach::Unknown);
        let mut anew = device.clone();
        let total = if device.as_drive().is_some() { 3 } else { 2 };
        anew.progress = Rc::new(Progress::of_one(&self.context, steps, total));
        let registers = &self.context.registers;
        let back = async {
            registers::request(
                registers,
                device.found.station,
                AlState::SafeOp,
                SAFE_OP_LIMIT,
            )
            .await
            .at(safe_op)?;
            anew.done(safe_op);
            anew.read_as_it_is_now(&self.context, device).await
        };
        back.await.of(&device.found.id)?;
        self.forget_what_is_not_homed(place, &anew);
        self.bring_into_op(place, member, &anew, Reattach::Kept)
            .await?;
        anew.done(BringUpStep::State(AlState::Op));
        *device = anew;
        Ok(())
    }

    /// A drive that has kept its power may have lost an encoder all the same: what it shows decides.
    fn forget_what_is_not_homed(&self, place: usize, device: &Device) {
        let axes = device.as_drive().map_or(&[][..], |drive| &drive.axes);
        for (number, axis) in axes.iter().enumerate() {
            if axis.shows_homed == Some(false) {
                self.axes.borrow_mut().forget_axis(place, number);
            }
        }
    }

    /// From SAFEOP into OP, once it has been given outputs that do nothing.
    async fn bring_into_op(
        &self,
        place: usize,
        member: &Member,
        device: &Device,
        again: fn(Box<CoreConfig>) -> Reattach,
    ) -> Result<(), NetworkError> {
        let id = &device.found.id;
        self.join_clocks(member, device).await?;
        if device.clocks().is_some() {
            let drives = iter::once(&device.found);
            clocks::wait_for_lock(&self.context, drives, self.period).await?;
        }
        // The targets are where the drive stands.
        self.until(|this| this.has_answered(place)).await.of(id)?;
        if let Some(drive) = device.as_drive() {
            self.axes.borrow_mut().hold(place, drive.held.clone());
        }
        let axes = device.as_drive().map_or(&[][..], |drive| &drive.axes);
        self.reattach(place, |number| match axes.get(number) {
            Some(axis) => again(Box::new(axis.config.clone())),
            None => Reattach::Unknown,
        });
        self.two_cycles().await;
        device.enter_op(&self.context).await.of(id)?;
        let status = AlStatus {
            state: AlState::Op,
            error: None,
        };
        note_state(&self.context, &self.control, place, &member.id, status);
        // With its axes switched off.
        self.until(|this| this.is_served(place) && this.axes.borrow().are_back(place))
            .await
            .of(id)?;
        self.ports.borrow_mut().release(place);
        member.phase.set(ReturnPhase::None);
        Ok(())
    }

    /// From now on what goes out to the device does nothing.
    pub fn reattach(&self, place: usize, again: impl FnMut(usize) -> Reattach) {
        let now = self.context.time.now();
        self.ports.borrow_mut().hold(place);
        let mut cycle = self.context.cycle.borrow_mut();
        if let Some(cycle) = cycle.as_mut() {
            let drives = &mut cycle.exchange.drives;
            self.axes.borrow_mut().restart(now, place, again, drives);
        }
    }

    /// Whether its inputs have come; of a device without inputs, that is not known before it is in OP.
    fn has_answered(&self, place: usize) -> bool {
        self.data(place, |data| {
            data.inputs.is_empty() || data.answer != Answer::Stale
        })
    }

    /// Whether the device takes its outputs.
    fn is_served(&self, place: usize) -> bool {
        self.data(place, |data| {
            data.is_operational() && data.answer == Answer::Fresh
        })
    }

    /// Waits until that is so after a cycle.
    async fn until(&self, is_so: impl Fn(&Self) -> bool) -> Result<(), StepError> {
        let limit = EXCHANGE_LIMIT + 4 * self.period;
        let time = &self.context.time;
        let until = time.now().saturating_add(limit);
        loop {
            self.two_cycles().await;
            if is_so(self) {
                return Ok(());
            }
            if time.now() >= until {
                return Err(DriveFault::NoExchange(limit)).at(BringUpStep::ProcessData);
            }
        }
    }

    /// Waits until what the outputs hold now has been sent, and what came of it has been looked at.
    async fn two_cycles(&self) {
        let cycles = &self.context.counters.cycles;
        let until = cycles.get() + 2;
        while cycles.get() < until {
            self.context.time.sleep(self.period / 2).await;
        }
    }

    fn data(&self, place: usize, of: impl FnOnce(&DriveData) -> bool) -> bool {
        let mut cycle = self.context.cycle.borrow_mut();
        data_of(&mut cycle, place).is_some_and(|data| of(data))
    }

    /// From now on nothing of the device is taken, and what goes out to it does nothing.
    pub fn cut_off(&self, place: usize) {
        self.reattach(place, |_| Reattach::Unknown);
        if let Some(cycle) = self.context.cycle.borrow_mut().as_mut() {
            cycle.exchange.drives.take_away(place);
        }
    }

    fn put_back(&self, place: usize, change: impl FnOnce(&mut DriveData)) {
        let mut cycle = self.context.cycle.borrow_mut();
        let drives = cycle.as_mut().map(|cycle| &mut cycle.exchange.drives);
        if let Some(data) = drives.and_then(|drives| drives.put_back(place)) {
            change(data);
        }
    }

    /// It has not come all the way back: it is not to be in OP. If that fails too, nothing moves by its outputs.
    async fn leave(&self, place: usize, member: &Member, found: &Found) {
        let registers = &self.context.registers;
        let station = found.station;
        match member.phase.get() {
            ReturnPhase::None => {}
            ReturnPhase::FromSafeOp => {
                // Nobody enables an axis of it that is about to leave OP.
                self.reattach(place, |_| Reattach::Unknown);
                // Also while it may still be on its way into OP, for which it was asked: some take their time.
                let may_be_in_op = |status: AlStatus| match status.state {
                    AlState::Op => true,
                    AlState::SafeOp => status.error.is_none(),
                    _ => false,
                };
                let seen = registers::status(registers, station).await;
                if seen.is_ok_and(may_be_in_op) {
                    let _ = registers::request(registers, station, AlState::SafeOp, SAFE_OP_LIMIT)
                        .await;
                }
                member.phase.set(ReturnPhase::None);
            }
            ReturnPhase::Anew => {
                // What it adds to a working counter until it is in INIT is no loss of those that share its datagram.
                self.cut_off(place);
                let _ = line::set_back(registers, station).await;
            }
        }
        self.put_back(place, |_| ());
    }
}

fn same_process_data(before: &Device, now: &Device) -> Result<(), StepError> {
    if now.exchanges_as(before) {
        return Ok(());
    }
    let (expected, got) = (before.sizes(), now.sizes());
    Err(DriveFault::OtherProcessData { expected, got }).at(BringUpStep::Mapping)
}

// A device of a line that was brought up, as far as its way back needs to know it.

/// A device of the exchange.
pub(in crate::bus) struct Member {
    /// Who it is, for notes.
    pub id: Arc<DriveId>,
    /// Whether all other clocks follow its own.
    is_reference: bool,
    /// How it is set up. Held by whoever brings it back.
    pub device: Mutex<Device>,
    /// How far it is.
    phase: Cell<ReturnPhase>,
    /// What is being written to the EEPROM of the drive that replaces it. Until all of it is there, the EEPROM holds no valid image.
    pub image: RefCell<Option<SiiImage>>,
}

impl Member {
    /// From now on it is set up from INIT.
    pub fn begin_anew(&self) {
        self.phase.set(ReturnPhase::Anew);
    }

    /// Whether it was left while it was set up from INIT.
    pub fn is_half_way(&self) -> bool {
        self.phase.get() == ReturnPhase::Anew
    }
}

/// How far a device is on its way back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ReturnPhase {
    /// Not on its way.
    None,
    /// Being led from SAFEOP into OP.
    FromSafeOp,
    /// Being set up anew, or left half-way there: it must be set up anew the next time.
    Anew,
}

/// The devices of a line that was brought up.
pub(in crate::bus) fn members(devices: Vec<Device>, reference: Option<&DriveId>) -> Vec<Member> {
    let members = devices.into_iter().map(|device| Member {
        id: Arc::new(device.found.id.clone()),
        is_reference: reference == Some(&device.found.id),
        device: Mutex::new(device),
        phase: Cell::new(ReturnPhase::None),
        image: RefCell::new(None),
    });
    members.collect()
}

// The distributed clock of a device that has begun anew in a line whose clocks run.

impl Recovery {
    /// Sees to it that the reference gives its time, where the device follows that or is it.
    async fn join_clocks(&self, member: &Member, device: &Device) -> Result<(), NetworkError> {
        match &self.clocks {
            Some(clocks) if member.is_reference || device.clocks().is_some() => {
                self.join_reference(clocks).await
            }
            _ => Ok(()),
        }
    }

    /// By the reference clock that all others follow, if it follows that too.
    async fn set_clock(&self, member: &Member, device: &Device) -> Result<(), NetworkError> {
        self.join_clocks(member, device).await?;
        let Some(clocks) = device.clocks() else {
            return Ok(());
        };
        clocks::wait_for_lock(&self.context, iter::empty(), self.period).await?;
        let known = {
            let cycle = self.context.cycle.borrow();
            cycle.as_ref().and_then(Cycle::reference_time)
        };
        if let Some((time, at)) = known {
            clocks.remember(time, at);
        }
        // By its own no other can be measured.
        if member.is_reference {
            return Ok(());
        }
        let Found { station, id, .. } = &device.found;
        let _latching = self.search.lock().await;
        // However it was found again: elsewhere in the line a frame takes another time to it than the clocks know.
        let registers = &self.context.registers;
        let line = self.line.borrow().clone();
        let here = line.place_of(registers, *station).await;
        let fault = match here {
            Ok(here) if here == Some(id.position) => None,
            Ok(_) => Some(DriveFault::ClockOfRunningLine),
            Err(error) => Some(DriveFault::Register(error)),
        };
        if let Some(fault) = fault {
            return Err(fault).at(BringUpStep::Clock).of(id);
        }
        clocks
            .set_anew(registers, *station, id.position)
            .await
            .at(BringUpStep::Clock)
            .of(id)
    }
}
