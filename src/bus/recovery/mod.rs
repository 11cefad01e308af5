//! The way of one device back into OP, while all others keep their cycles and their motions.
//!
//! Only the program asks for it. Before anything is done with the device its axes begin again: what they were told is over,
//! and what goes out to them is that of an axis that is switched off.

mod clock;
mod device;
mod find;
mod recovered;

use std::{cell::RefCell, iter, rc::Rc, sync::Arc, time::Duration};

use smol::{channel::Sender, future::or, lock::Mutex};

use super::{
    AlState, AlStatus, BringUpStep, DriveFault, NetworkError, RegisterError, Verdict, al,
    axes::Axes,
    bring_up,
    control::Control,
    dc,
    discovery::{self, Found, STATION_ADDRESS},
    drive_data::{Answer, DriveData},
    drive_setup::{Failed, Job, SAFE_OP_LIMIT},
    io::{IoJob, Ports, ReadyIo},
    log::Note,
    packing::Member,
    progress::{Progress, StepDone},
    reactor::Context,
    whereabouts::{data_of, note_state},
};
use crate::{
    axis::{Again, AxisConfig},
    coe::DriveId,
    pdo_map::Layout,
};

pub(super) use device::devices;
use device::{Device, SetUp, Stage};
pub use recovered::Recovered;

/// Leads devices of the exchange back into OP.
pub(super) struct Recovery {
    pub(super) context: Context,
    pub(super) control: Arc<Control>,
    pub(super) period: Duration,
    pub(super) axes: Rc<RefCell<Axes>>,
    pub(super) ports: Rc<RefCell<Ports>>,
    /// All devices of the line, as they were found at the start.
    pub(super) line: Vec<DriveId>,
    /// In the order of the exchange.
    pub(super) devices: Vec<Device>,
    /// Held by whoever looks for a device.
    pub(super) search: Mutex<()>,
}

impl Recovery {
    /// Leads one back, unless whoever asked for it goes away.
    pub(super) async fn serve(
        &self,
        place: usize,
        steps: Sender<StepDone>,
        reply: &Sender<Result<Recovered, NetworkError>>,
    ) {
        let Some(device) = self.devices.get(place) else {
            return;
        };
        let _in_work = device.in_work.lock().await;
        let recovery = async { Some(self.recover(place, device, steps).await) };
        let given_up = async {
            reply.closed().await;
            None
        };
        let result = or(given_up, recovery).await;
        if !matches!(result, Some(Ok(_))) {
            self.leave(place, device).await;
        }
        let note = match &result {
            Some(Ok(recovered)) => Note::Recovered(Arc::clone(&device.id), *recovered),
            Some(Err(error)) => Note::NotRecovered(Arc::clone(&device.id), Some(error.to_string())),
            None => Note::NotRecovered(Arc::clone(&device.id), None),
        };
        self.context.log.note(self.context.time.now(), note);
        if let Some(result) = result {
            // Whoever has gone away by now misses it.
            let _ = reply.try_send(result);
        }
    }

    async fn recover(
        &self,
        place: usize,
        device: &Device,
        steps: Sender<StepDone>,
    ) -> Result<Recovered, NetworkError> {
        let found = &device.found;
        let from = match al::status(&self.context.registers, found.station).await {
            Ok(status) => status,
            Err(RegisterError::NotAnswered) => {
                let position = self.find(place, device).await?;
                self.bring_up(place, device, steps).await?;
                let from = None;
                return Ok(Recovered::BroughtUp { position, from });
            }
            Err(error) => return Err(device.fault((BringUpStep::Identity, error.into()))),
        };
        note_state(&self.context, &self.control, place, &device.id, from);
        let half_way = device.stage.get() == Stage::Anew;
        match from.state {
            AlState::Op if from.error.is_none() && !half_way => {
                let is_served = self.until(|this| this.is_served(place));
                is_served.await.map_err(|failed| device.fault(failed))?;
                // An attempt before may have failed while it was cut off.
                self.ports.borrow_mut().release(place);
                Ok(Recovered::WasInOp)
            }
            AlState::Op | AlState::SafeOp if !half_way => {
                self.lead_back(place, device, steps).await?;
                Ok(Recovered::LedBack { from })
            }
            _ => {
                self.bring_up(place, device, steps).await?;
                Ok(Recovered::BroughtUp {
                    position: found.id.position,
                    from: Some(from),
                })
            }
        }
    }

    /// Gives it its station address again, wherever it is in the line now.
    async fn find(&self, place: usize, device: &Device) -> Result<u16, NetworkError> {
        // By its address the time is read that all others get.
        if device.is_reference {
            return Err(device.fault((BringUpStep::Clock, DriveFault::ReferenceOfRunningLine)));
        }
        self.cut_off(place);
        let _searching = self.search.lock().await;
        let at_start = &device.found.id;
        let position = find::find(&self.context.registers, &self.line, at_start).await?;
        if device.synchronised && position != at_start.position {
            return Err(device.fault((BringUpStep::Clock, DriveFault::ClockOfRunningLine)));
        }
        Ok(position)
    }

    /// As at the start, from INIT.
    async fn bring_up(
        &self,
        place: usize,
        device: &Device,
        steps: Sender<StepDone>,
    ) -> Result<(), NetworkError> {
        let found = &device.found;
        device.stage.set(Stage::Anew);
        self.axes.borrow_mut().forget(place);
        self.cut_off(place);
        self.lead_into_pre_op(device).await?;
        self.set_clock(device).await?;
        let progress = |drives, ios| Rc::new(Progress::new(&self.context, steps, drives, ios));
        let (progress, configs) = match &device.set_up {
            SetUp::Drive(set_up) => {
                let progress = progress(1, 0);
                let configs = self.set_up_drive(set_up, &progress).await?;
                (progress, configs)
            }
            SetUp::Io(before) => {
                let progress = progress(0, 1);
                self.set_up_io(before, &progress).await?;
                (progress, Vec::new())
            }
        };
        self.with_data(place, DriveData::put_back);
        if device.clocks().is_some() {
            self.context.time.sleep(dc::settling(self.period)).await;
        }
        let again = |number| match configs.get(number) {
            Some(config) => Again::Anew(Box::new(AxisConfig::clone(config))),
            None => Again::Unknown,
        };
        self.lead_into_op(place, device, again).await?;
        progress.step(&found.id, BringUpStep::State(AlState::Op));
        Ok(())
    }

    /// Set back, and with a mailbox.
    async fn lead_into_pre_op(&self, device: &Device) -> Result<(), NetworkError> {
        let registers = &self.context.registers;
        let Found { station, id, .. } = &device.found;
        let init = BringUpStep::State(AlState::Init);
        discovery::set_back(registers, *station)
            .await
            .map_err(|error| device.fault((init, error.into())))?;
        if let Some(mail) = device.mail() {
            mail.begin_anew();
        }
        let there = discovery::find(registers.clone(), id.position, *station).await?;
        if there.id.identity == id.identity {
            return Ok(());
        }
        // It is none of ours.
        let _ = registers.write(*station, STATION_ADDRESS, &[0; 2]).await;
        let other = Some((id.position.into(), there.id.identity));
        Err(find::mismatch(id, other, Verdict::Different))
    }

    /// From PREOP into SAFEOP; gives what was read for each axis.
    async fn set_up_drive(
        &self,
        (job, layout, member): &(Job, Layout, Member),
        progress: &Rc<Progress>,
    ) -> Result<Vec<AxisConfig>, NetworkError> {
        let job = Job {
            progress: Rc::clone(progress),
            ..job.clone()
        };
        let ready = job.run(self.context.clone()).await?;
        let now = bring_up::member(&ready);
        if ready.layout != *layout || now.lrw != member.lrw {
            return Err(others(
                &ready.found,
                (member.outputs, member.inputs),
                (now.outputs, now.inputs),
            ));
        }
        Ok(ready.axes.into_iter().map(|axis| axis.config).collect())
    }

    /// From PREOP into SAFEOP.
    async fn set_up_io(
        &self,
        before: &ReadyIo,
        progress: &Rc<Progress>,
    ) -> Result<(), NetworkError> {
        let job = IoJob {
            progress: Rc::clone(progress),
            ..before.again.clone()
        };
        let mut io = job.look(self.context.clone()).await?;
        if !io.exchanges_as(before) {
            return Err(others(&io.found, before.sizes(), io.sizes()));
        }
        io.logical = before.logical;
        io.into_safe_op(self.context.clone()).await.map(drop)
    }

    /// From SAFEOP, with the error that has led there.
    async fn lead_back(
        &self,
        place: usize,
        device: &Device,
        steps: Sender<StepDone>,
    ) -> Result<(), NetworkError> {
        let Found { station, id, .. } = &device.found;
        let safe_op = BringUpStep::State(AlState::SafeOp);
        let progress = Progress::of_one(&self.context, steps, 2);
        device.stage.set(Stage::LedBack);
        self.begin_again(place, |_| Again::Unknown);
        let registers = &self.context.registers;
        al::request(registers, *station, AlState::SafeOp, SAFE_OP_LIMIT)
            .await
            .map_err(|error| device.fault((safe_op, error.into())))?;
        progress.step(id, safe_op);
        self.lead_into_op(place, device, |_| Again::Kept).await?;
        progress.step(id, BringUpStep::State(AlState::Op));
        Ok(())
    }

    /// From SAFEOP into OP, once it has been given outputs that do nothing.
    async fn lead_into_op(
        &self,
        place: usize,
        device: &Device,
        again: impl FnMut(usize) -> Again,
    ) -> Result<(), NetworkError> {
        let Found { station, .. } = &device.found;
        if device.synchronised {
            let drives = iter::once(&device.found);
            dc::wait_for_lock(&self.context, drives, self.period).await?;
        }
        // The targets are where the drive stands.
        let has_answered = self.until(|this| this.has_answered(place));
        has_answered.await.map_err(|failed| device.fault(failed))?;
        self.begin_again(place, again);
        self.two_cycles().await;
        bring_up::into_op(&self.context.registers, *station, device.lists.as_ref())
            .await
            .map_err(|failed| device.fault(failed))?;
        let status = AlStatus {
            state: AlState::Op,
            error: None,
        };
        note_state(&self.context, &self.control, place, &device.id, status);
        // With its axes switched off.
        let is_back =
            self.until(|this| this.is_served(place) && this.axes.borrow().are_back(place));
        is_back.await.map_err(|failed| device.fault(failed))?;
        self.ports.borrow_mut().release(place);
        device.stage.set(Stage::None);
        Ok(())
    }

    /// From now on what goes out to the device does nothing.
    fn begin_again(&self, place: usize, again: impl FnMut(usize) -> Again) {
        let now = self.context.time.now();
        self.ports.borrow_mut().hold(place);
        let mut cycle = self.context.cycle.borrow_mut();
        if let Some(cycle) = cycle.as_mut() {
            let drives = &mut cycle.exchange.drives;
            self.axes.borrow_mut().restart(now, place, again, drives);
        }
    }

    /// Whether its inputs have come; of a device without inputs, nothing can tell before it is in OP.
    fn has_answered(&self, place: usize) -> bool {
        self.data(place, |data| {
            data.inputs.is_empty() || data.answer != Answer::Stale
        })
    }

    /// Whether the device takes its outputs.
    fn is_served(&self, place: usize) -> bool {
        self.data(place, |data| {
            data.operational && data.answer == Answer::Fresh
        })
    }

    /// Waits until that is so after a cycle.
    async fn until(&self, is_so: impl Fn(&Self) -> bool) -> Result<(), Failed> {
        let limit = bring_up::EXCHANGE_LIMIT + 4 * self.period;
        let time = &self.context.time;
        let until = time.now().saturating_add(limit);
        loop {
            self.two_cycles().await;
            if is_so(self) {
                return Ok(());
            }
            if time.now() >= until {
                return Err((BringUpStep::ProcessData, DriveFault::NoExchange(limit)));
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
    fn cut_off(&self, place: usize) {
        self.begin_again(place, |_| Again::Unknown);
        if let Some(cycle) = self.context.cycle.borrow_mut().as_mut() {
            cycle.exchange.drives.take_away(place);
        }
    }

    fn with_data(&self, place: usize, change: impl FnOnce(&mut DriveData)) {
        let mut cycle = self.context.cycle.borrow_mut();
        if let Some(data) = data_of(&mut cycle, place) {
            change(data);
        }
    }

    /// It has not come all the way back: it is not to be in OP. If that fails too, nothing moves by its outputs.
    async fn leave(&self, place: usize, device: &Device) {
        let registers = &self.context.registers;
        let station = device.found.station;
        match device.stage.get() {
            Stage::None => {}
            Stage::LedBack => {
                let in_op = |status: AlStatus| status.state == AlState::Op;
                if al::status(registers, station).await.is_ok_and(in_op) {
                    let _ = al::request(registers, station, AlState::SafeOp, SAFE_OP_LIMIT).await;
                }
                device.stage.set(Stage::None);
            }
            Stage::Anew => drop(discovery::set_back(registers, station).await),
        }
        self.with_data(place, |data| data.away = false);
    }
}

/// The fault of a device that exchanges other process data than before.
fn others(found: &Found, expected: (usize, usize), got: (usize, usize)) -> NetworkError {
    let fault = DriveFault::OtherProcessData { expected, got };
    found.clone().fault(BringUpStep::Mapping, fault)
}
