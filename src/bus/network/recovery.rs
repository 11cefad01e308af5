//! The way of one device back into OP, while all others keep their cycles and their motions.
//!
//! Only the program asks for it. Before anything is done with the device its axes begin again: what they were told is over,
//! and what goes out to them is that of an axis that is switched off.

use std::{
    cell::{Cell, RefCell},
    iter,
    rc::Rc,
    sync::Arc,
    time::Duration,
};

use smol::{channel::Sender, future::or, lock::Mutex};

use crate::{
    axis::{Again, AxisConfig},
    bus::{
        clocks::{measure::Clocks, sync},
        cycle::{
            Cycle,
            exchange::{Answer, DriveData},
            packing::Member,
        },
        device::{
            drive::{DriveSetup, Failed, SAFE_OP_LIMIT},
            io_port::Ports,
            io_setup::{IoSetup, ReadyIo},
            progress::{Progress, StepDone},
        },
        error::{AlState, AlStatus, BringUpStep, DriveFault, NetworkError, RegisterError},
        event::Recovered,
        expected::Verdict,
        line::{self, Found, STATION_ADDRESS, find},
        log::LogRecord,
        network::{
            axes::Axes,
            bring_up::{self, Ready},
        },
        requests::{Context, al},
        watch::{
            Control,
            al_monitor::{data_of, note_state},
        },
    },
    coe::{DriveId, MailSignal, SdoHandle},
    parameters::StartUpList,
    pdo_map::Layout,
};

/// Leads devices of the exchange back into OP.
pub(in crate::bus) struct Recovery {
    pub(in crate::bus) context: Context,
    pub(in crate::bus) control: Arc<Control>,
    pub(in crate::bus) period: Duration,
    pub(in crate::bus) axes: Rc<RefCell<Axes>>,
    pub(in crate::bus) ports: Rc<RefCell<Ports>>,
    /// All devices of the line, as they were found at the start.
    pub(in crate::bus) line: Vec<DriveId>,
    /// In the order of the exchange.
    pub(in crate::bus) devices: Vec<Device>,
    /// Held by whoever looks for a device.
    pub(in crate::bus) search: Mutex<()>,
}

impl Recovery {
    /// Leads one back, unless whoever asked for it goes away.
    pub(in crate::bus) async fn serve(
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
            Some(Ok(recovered)) => LogRecord::Recovered(Arc::clone(&device.id), *recovered),
            Some(Err(error)) => {
                LogRecord::NotRecovered(Arc::clone(&device.id), Some(error.to_string()))
            }
            None => LogRecord::NotRecovered(Arc::clone(&device.id), None),
        };
        self.context.log.record(self.context.time.now(), note);
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
        let half_way = device.phase.get() == ReturnPhase::Anew;
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
                Ok(Recovered::FromSafeOp { from })
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
        device.phase.set(ReturnPhase::Anew);
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
            self.context.time.sleep(sync::settling(self.period)).await;
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
        line::set_back(registers, *station)
            .await
            .map_err(|error| device.fault((init, error.into())))?;
        if let Some(mail) = device.mail() {
            mail.begin_anew();
        }
        let there = line::find(registers.clone(), id.position, *station).await?;
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
        (job, layout, member): &(DriveSetup, Layout, Member),
        progress: &Rc<Progress>,
    ) -> Result<Vec<AxisConfig>, NetworkError> {
        let job = DriveSetup {
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
        let job = IoSetup {
            progress: Rc::clone(progress),
            ..before.setup.clone()
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
        device.phase.set(ReturnPhase::FromSafeOp);
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
            sync::wait_for_lock(&self.context, drives, self.period).await?;
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
        device.phase.set(ReturnPhase::None);
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
        match device.phase.get() {
            ReturnPhase::None => {}
            ReturnPhase::FromSafeOp => {
                let in_op = |status: AlStatus| status.state == AlState::Op;
                if al::status(registers, station).await.is_ok_and(in_op) {
                    let _ = al::request(registers, station, AlState::SafeOp, SAFE_OP_LIMIT).await;
                }
                device.phase.set(ReturnPhase::None);
            }
            ReturnPhase::Anew => drop(line::set_back(registers, station).await),
        }
        self.with_data(place, |data| data.away = false);
    }
}

/// The fault of a device that exchanges other process data than before.
fn others(found: &Found, expected: (usize, usize), got: (usize, usize)) -> NetworkError {
    let fault = DriveFault::OtherProcessData { expected, got };
    found.clone().fault(BringUpStep::Mapping, fault)
}

// A device of a line that was brought up, as far as its way back needs to know it.

/// A device of the exchange.
pub(in crate::bus) struct Device {
    pub(in crate::bus) found: Found,
    /// Who it is, for notes.
    pub(in crate::bus) id: Arc<DriveId>,
    /// What is written to it on its way into OP.
    pub(in crate::bus) lists: Option<(SdoHandle, Vec<StartUpList>)>,
    /// Whether it follows SYNC0.
    pub(in crate::bus) synchronised: bool,
    /// Whether all other clocks follow its own.
    pub(in crate::bus) is_reference: bool,
    pub(in crate::bus) set_up: SetUp,
    /// Held by whoever leads it back.
    pub(in crate::bus) in_work: Mutex<()>,
    /// How far it is.
    pub(in crate::bus) phase: Cell<ReturnPhase>,
}

/// How a device is set up, and what came of it at the start.
pub(in crate::bus) enum SetUp {
    Drive(Box<(DriveSetup, Layout, Member)>),
    Io(Box<ReadyIo>),
}

/// How far a device is on its way back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) enum ReturnPhase {
    /// Not on its way.
    None,
    /// Being led from SAFEOP into OP.
    FromSafeOp,
    /// Being set up anew, or left half-way there: it must be set up anew the next time.
    Anew,
}

/// The devices of a line that was brought up.
pub(in crate::bus) fn devices(ready: Ready) -> Vec<Device> {
    let reference = ready.reference();
    let device = |found: Found, lists, synchronised, set_up| Device {
        id: Arc::new(found.id.clone()),
        is_reference: reference.as_ref() == Some(&found.id),
        found,
        lists,
        synchronised,
        set_up,
        in_work: Mutex::new(()),
        phase: Cell::new(ReturnPhase::None),
    };
    let drives = ready.drives.into_iter();
    let drives = drives.map(|drive| {
        let member = bring_up::member(&drive);
        let lists = (drive.sdo, drive.start_up);
        let set_up = SetUp::Drive(Box::new((drive.setup, drive.layout, member)));
        device(
            drive.found,
            Some(lists),
            drive.sync0_after.is_some(),
            set_up,
        )
    });
    let ios = ready.ios.into_iter().map(|io| {
        let sdo = io.mailbox.as_ref().map(|mailbox| mailbox.sdo.clone());
        let lists = sdo.map(|sdo| (sdo, io.start_up.clone()));
        device(io.found.clone(), lists, false, SetUp::Io(Box::new(io)))
    });
    drives.chain(ios).collect()
}

impl Device {
    /// The line's clocks, if its own follows the reference.
    pub(in crate::bus) fn clocks(&self) -> Option<&Rc<Clocks>> {
        match &self.set_up {
            SetUp::Drive(set_up) if self.synchronised => set_up.0.clocks.as_ref(),
            SetUp::Drive(_) | SetUp::Io(_) => None,
        }
    }

    /// What its mailbox client is told by, if it has one.
    pub(in crate::bus) fn mail(&self) -> Option<&MailSignal> {
        let mailbox = match &self.set_up {
            SetUp::Drive(set_up) => set_up.0.mailbox.as_ref(),
            SetUp::Io(io) => io.mailbox.as_ref(),
        };
        mailbox.map(|mailbox| &mailbox.signal)
    }

    /// The error of a step, with the device.
    pub(in crate::bus) fn fault(&self, (step, error): Failed) -> NetworkError {
        self.found.clone().fault(step, error)
    }
}

// The distributed clock of a device that has begun anew in a line whose clocks run.

impl Recovery {
    /// By the reference clock that all others follow, if it follows that too.
    pub(in crate::bus) async fn set_clock(&self, device: &Device) -> Result<(), NetworkError> {
        let Some(clocks) = device.clocks() else {
            return Ok(());
        };
        sync::wait_for_lock(&self.context, iter::empty(), self.period).await?;
        let known = {
            let cycle = self.context.cycle.borrow();
            cycle.as_ref().and_then(Cycle::reference_time)
        };
        if let Some((time, at)) = known {
            clocks.remember(time, at);
        }
        // Its own was not set.
        if device.is_reference {
            return Ok(());
        }
        let Found { station, id, .. } = &device.found;
        let _latching = self.search.lock().await;
        clocks
            .set_anew(&self.context.registers, *station, id.position)
            .await
            .map_err(|error| device.fault((BringUpStep::Clock, error)))
    }
}
