//! The future that leads a network through its life: bring-up, watching over the AL states, the end in order.

use std::{cell::RefCell, rc::Rc, sync::Arc, time::Duration};

use async_task::Task;
use smol::{channel::Sender, lock::Mutex};

use super::{
    axes::Axes,
    bring_up::{self, Ready},
    builder::LinePlan,
    hot_connect::{Group, GroupState, HotConnecting},
    recovery::{self, Recovery},
};
use crate::{
    Failure,
    axis::{AxisSource, Delivery},
    bus::{
        clocks::LockWatch,
        cycle::black_box::{AxisIncident, BlackBox, CycleRing},
        device::{
            io::Io,
            io_port::Ports,
            progress::{Progress, StepDone},
        },
        error::{AlError, AlState, NetworkError},
        event::{ClockEvent, NetworkEvent},
        expected::DevicePlace,
        line::Found,
        log::LogRecord,
        requests::{Context, registers},
        watch::{self, Control, MiscountWatch, Question, at_once, look, read_state},
    },
    coe::{DriveId, Emergencies, ErrorTexts, SdoHandle},
    esc,
    wakes::WakeStatistics,
};

/// How often the shutdown flag is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(5);
/// How often AL states are read while something is wrong with them.
const AL_EVERY: Duration = Duration::from_millis(20);
/// How long axes may take to stop and disable at the end, beside their own deadlines.
const DISABLE_LIMIT: Duration = Duration::from_secs(1);
/// How long each AL state may take on the way down.
const DOWN_LIMIT: Duration = Duration::from_secs(1);
/// Error indication and SAFEOP, in the AL states of a line OR-ed together.
const FALLEN: u8 = 0x14;
/// The states, and OP alone.
const STATE: u8 = 0x0F;
const OP: u8 = 0x08;

/// What a program gets of a network that is in OP.
pub(in crate::bus) struct Started {
    pub axes: Vec<AxisSource>,
    pub drives: Vec<StartedDrive>,
    pub ios: Vec<Io>,
    /// Where all devices of the exchange stand, in its order, and how they were declared.
    pub places: Vec<(u16, DevicePlace)>,
    /// Those of all drives.
    pub emergencies: Emergencies,
    /// The last cycles, as recorders read them.
    pub ring: Arc<CycleRing>,
    /// The optional groups.
    pub groups: Vec<Arc<GroupState>>,
}

/// The mailbox of a drive, or of another device that has one.
pub(in crate::bus) struct StartedDrive {
    pub id: DriveId,
    /// How it was declared.
    pub place: DevicePlace,
    /// Its place in the exchange.
    pub in_exchange: usize,
    pub sdo: SdoHandle,
    pub emergencies: Emergencies,
    pub error_texts: Arc<ErrorTexts>,
}

/// Leads the network, and ends the loop.
pub(in crate::bus) async fn supervise(
    context: Context,
    plan: LinePlan,
    control: Arc<Control>,
    started: Sender<Result<Started, NetworkError>>,
    steps: Sender<StepDone>,
) {
    let _end_of_events = EndOfEvents(Arc::clone(&control));
    let period = plan.cycle;
    let bring_up = smol::future::or(
        async { Some(start(&context, plan, &control, steps).await) },
        async {
            given_up(&context, &control).await;
            None
        },
    );
    match bring_up.await {
        Some(Ok((running, to_program))) => {
            if started.send(Ok(to_program)).await.is_ok() {
                let watching = watch(&context, &running, &control, period);
                let answering = answer(&context, &running, &control);
                let watching = smol::future::or(watching, running.connecting.run());
                smol::future::or(watching, answering).await;
            }
            end(&context, &running, &control, period).await;
        }
        Some(Err(error)) => {
            leave(&context).await;
            drop(started.send(Err(error)).await);
        }
        None => leave(&context).await,
    }
    context.end();
}

/// Whoever waits for events learns of the end: of one that nobody has asked for, and of a loop that is dropped, too.
struct EndOfEvents(Arc<Control>);

impl Drop for EndOfEvents {
    fn drop(&mut self) {
        self.0.end_events();
    }
}

/// What works with the process data, and all devices in the order of the exchange.
struct Running {
    axes: Rc<RefCell<Axes>>,
    ports: Rc<RefCell<Ports>>,
    /// Each by its station address, with who it is for notes.
    devices: Vec<(u16, Arc<DriveId>)>,
    /// So many of them last; the others come and go.
    lasting: usize,
    /// Whose clock is the reference.
    reference: Option<Arc<DriveId>>,
    recovery: Rc<Recovery>,
    connecting: HotConnecting,
}

async fn start(
    context: &Context,
    plan: LinePlan,
    control: &Arc<Control>,
    steps: Sender<StepDone>,
) -> Result<(Running, Started), NetworkError> {
    let period = plan.cycle;
    let progress = Progress::new(context, steps, plan.drives.len(), plan.ios.len());
    let progress = Rc::new(progress);
    let declared: Vec<_> = plan.optional().collect();
    let groups = plan.groups.iter().map(|group| group.name.clone());
    let groups: Vec<_> = groups.map(GroupState::new).collect();
    let ready = bring_up::configure(context, plan, &progress).await?;
    let (axes, sources) = Axes::open(
        &ready.devices,
        Arc::clone(control),
        &context.wakes,
        context.log.clone(),
    );
    let axes = Rc::new(RefCell::new(axes));
    let ports = Ports::open(&ready.devices);
    let ios = ports.handles();
    let ports = Rc::new(RefCell::new(ports));
    let stepper = (Rc::clone(&axes), Rc::clone(&ports));
    let stepper = Box::new((stepper, control.tick.source()));
    bring_up::start_cycles(context, &ready, stepper, period).await?;
    bring_up::operate(context, &ready, period, &progress).await?;
    axes.borrow_mut().in_op();
    // Handles show what the last cycle was: whoever looks at once is to see devices in OP.
    let before = control.tick.ended();
    while control.tick.ended() == before {
        context.time.sleep(period).await;
    }
    let ring = context
        .cycle
        .borrow()
        .as_ref()
        .map(|cycle| cycle.exchange.ring());
    let ring = ring.ok_or_else(|| NetworkError::Thread("the cycle was ended".into()))?;
    let mailboxes = ready.devices.iter().enumerate();
    let mailboxes = mailboxes.filter_map(|(in_exchange, device)| {
        let mailbox = device.mailbox.as_ref()?;
        Some(StartedDrive {
            id: device.found.id.clone(),
            place: device.place,
            in_exchange,
            sdo: mailbox.sdo.clone(),
            emergencies: mailbox.emergencies.clone(),
            error_texts: Arc::clone(&mailbox.error_texts),
        })
    });
    let to_program = Started {
        axes: sources,
        drives: mailboxes.collect(),
        ios,
        places: ready
            .devices
            .iter()
            .map(|device| (device.found.id.position, device.place))
            .collect(),
        emergencies: context.emergencies.1.clone(),
        ring,
        groups,
    };
    let reference = ready.reference().map(Arc::new);
    let Ready {
        devices,
        line,
        lasting,
        groups: of_groups,
        clocks,
    } = ready;
    let stations = devices.iter().map(|device| {
        let Found { station, id, .. } = &device.found;
        (*station, Arc::new(id.clone()))
    });
    let stations: Vec<_> = stations.collect();
    let recovery = Rc::new(Recovery {
        context: context.clone(),
        control: Arc::clone(control),
        period,
        axes: Rc::clone(&axes),
        ports: Rc::clone(&ports),
        line: RefCell::new(line),
        clocks,
        devices: recovery::members(devices, reference.as_deref()),
        search: Mutex::new(()),
    });
    let mut declared = declared.into_iter();
    let of_groups = of_groups.into_iter().zip(&to_program.groups);
    let of_groups = of_groups.map(|((first, places), state)| {
        let declared = declared.by_ref().take(places.len()).collect();
        Group::new(Arc::clone(state), first, places, declared)
    });
    let connecting = HotConnecting::new(Rc::clone(&recovery), of_groups.collect());
    connecting.begin().await?;
    let running = Running {
        axes,
        ports,
        devices: stations,
        lasting,
        reference,
        recovery,
        connecting,
    };
    Ok((running, to_program))
}

/// Resolves when the program wants the end.
pub(in crate::bus) async fn given_up(context: &Context, control: &Control) {
    while !control.is_shutdown() {
        context.time.sleep(LOOK_EVERY).await;
    }
}

/// Watches over the drives until the network is to end.
async fn watch(context: &Context, running: &Running, control: &Arc<Control>, period: Duration) {
    let mut turn = 0;
    let lasting = running.devices.iter().take(running.lasting);
    let lasting: Vec<_> = lasting.map(|(_, id)| Arc::clone(id)).collect();
    let mut lost = vec![false; lasting.len()];
    let mut lock = LockWatch::new();
    let mut wakers = WakeStatistics::default();
    let mut miscounts = MiscountWatch::new();
    let mut late = Duration::ZERO;
    while !control.is_shutdown() {
        context.time.rest(LOOK_EVERY).await;
        if let Some(event) = lock.look(context.counters.clock.read())
            && let Some(reference) = &running.reference
        {
            // Who has moved the clock, and what its drive does now, nobody knows; the others agree still.
            if matches!(event, ClockEvent::Jumped { .. }) {
                let mut axes = running.axes.borrow_mut();
                axes.disable(Failure::ClockJumped);
            }
            let note = LogRecord::Clock(Arc::clone(reference), event);
            context.log.record(context.time.now(), note);
            let reference = DriveId::clone(reference);
            control.report(NetworkEvent::Clock { reference, event });
        }
        let seen = context.wakes.statistics();
        if seen.slow > wakers.slow || seen.panicked > wakers.panicked {
            context
                .log
                .record(context.time.now(), LogRecord::Wakers(seen));
            wakers = seen;
        }
        // Each time that it is twice as bad.
        if let Some(away) = context.counters.latest()
            && away > late.saturating_mul(2)
        {
            late = away;
            let note = LogRecord::LateFrames {
                away,
                cycle: period,
            };
            context.log.record(context.time.now(), note);
        }
        let Some((al_status, wrong)) = look(context, control, &lasting, &mut lost) else {
            return;
        };
        miscounts.look(context, control, &running.devices);
        loop {
            let passed = running.axes.borrow_mut().next_passed();
            let Some(event) = passed else { break };
            let note = LogRecord::Passed(event.clone());
            context.log.record(context.time.now(), note);
            control.report(event);
        }
        // After what happened to the drives, so that one follows from the other.
        let axes = &running.axes;
        let incidents = axes.borrow_mut().take_incidents();
        for (index, incident) in incidents {
            // A thousand cycles are read at once: those of all axes of a machine would keep the next cycle waiting. Meanwhile the
            // program takes the events from before.
            context.time.sleep(period.min(LOOK_EVERY)).await;
            if let Some(black_box) = black_box(context, axes, index, Some(incident)) {
                control.report(NetworkEvent::AxisIncident(Arc::new(black_box)));
            }
            if control.is_shutdown() {
                return;
            }
        }
        let Some(seen) = al_status else { continue };
        // A drive that has fallen before the first look is not normal: SubDevices that nobody has declared are in PREOP.
        let usual = &running.connecting.usual;
        if usual.get().is_none() && !wrong && seen.0 & FALLEN == 0 {
            usual.set(Some(seen));
        }
        let all_operational = context.cycle.borrow().as_ref().is_some_and(|cycle| {
            let mut drives = cycle.exchange.drives.iter();
            drives.all(|drive| drive.away || drive.is_operational())
        });
        let is_usual = usual.get() == Some(seen) && !wrong && all_operational;
        if is_usual && seen.0 & STATE == OP {
            continue;
        }
        let devices = running.devices.iter().enumerate();
        // Behind a device that is not in OP another one hides that has left it: they are asked in turn.
        let asked = devices.filter(|(place, _)| !is_usual || *place == turn);
        let looks = asked.map(|(place, (station, id))| {
            let (context, control) = (context.clone(), Arc::clone(control));
            read_state(context, control, place, *station, Arc::clone(id))
        });
        at_once(context, looks).await;
        if is_usual {
            turn = (turn + 1) % running.devices.len().max(1);
        } else {
            context.time.sleep(AL_EVERY).await;
        }
    }
}

/// Answers what the program asks; nobody waits for somebody else's answer.
async fn answer(context: &Context, running: &Running, control: &Control) {
    // They end with the network.
    let mut under_way: Vec<Task<()>> = Vec::new();
    // An asker that went away misses its answer.
    while let Ok(question) = control.questions.1.recv().await {
        under_way.retain(|task| !task.is_finished());
        match question {
            Question::BlackBox(index, reply) => {
                if let Some(black_box) = black_box(context, &running.axes, index, None) {
                    let _ = reply.try_send(black_box);
                }
            }
            Question::Ports(reply) => {
                let asked = context.clone();
                let reading = async move {
                    let _ = reply.try_send(watch::read_port_errors(&asked).await);
                };
                under_way.extend(context.spawn(reading));
            }
            Question::States(reply) => {
                let (asked, recovery) = (context.clone(), Rc::clone(&running.recovery));
                let reading = async move {
                    let line = recovery.line.borrow().devices.clone();
                    let _ = reply.try_send(watch::read_states(&asked, &line).await);
                };
                under_way.extend(context.spawn(reading));
            }
            Question::Recover(place, steps, reply) => {
                let recovery = Rc::clone(&running.recovery);
                let way_back = async move { recovery.serve(place, None, steps, &reply).await };
                under_way.extend(context.spawn(way_back));
            }
            Question::Replace(place, by, steps, reply) => {
                let recovery = Rc::clone(&running.recovery);
                let way_back = async move { recovery.serve(place, Some(by), steps, &reply).await };
                under_way.extend(context.spawn(way_back));
            }
        }
    }
}

/// What the last cycles of an axis were; `None` when there are no cycles any more.
fn black_box(
    context: &Context,
    axes: &RefCell<Axes>,
    index: usize,
    incident: Option<AxisIncident>,
) -> Option<BlackBox> {
    let mut cycle = context.cycle.borrow_mut();
    let exchange = &mut cycle.as_mut()?.exchange;
    exchange.complete_record();
    axes.borrow()
        .black_box(index, incident, |axis| exchange.history(axis))
}

/// The end in order: axes stopped and disabled, all other outputs 0, then SAFEOP, no more cycles, PREOP, INIT.
async fn end(context: &Context, running: &Running, control: &Control, period: Duration) {
    let time = &context.time;
    let axes = &running.axes;
    axes.borrow_mut().disable(Failure::BusLost {
        delivery: Delivery::NotSent,
    });
    let limit = axes.borrow().longest_stop().saturating_add(DISABLE_LIMIT);
    let until = time.now().saturating_add(limit);
    loop {
        // The first look is after a cycle, so that what was asked for has been sent.
        time.sleep(period.saturating_mul(2)).await;
        // Those that do not answer are not waited for: their drives have stopped them by their watchdog, or will.
        let all = axes.borrow();
        if all.moving().any(|axis| axis.answers) && time.now() < until {
            continue;
        }
        let moving: Vec<_> = all.moving().collect();
        if !moving.is_empty() {
            context.log.record(time.now(), LogRecord::NotStopped);
            // Nobody else sets it.
            let _ = control.left_moving.set(moving);
        }
        break;
    }
    // A brake or a valve holds what it holds for as long as an axis moves.
    running.ports.borrow_mut().end();
    running.axes.borrow_mut().end();
    time.sleep(period.saturating_mul(2)).await;
    let is_there = |place: usize| !running.axes.borrow().is_absent(place);
    let there = running.devices.iter().enumerate();
    let there = there.filter(|(place, _)| is_there(*place));
    let mut there: Vec<_> = there.map(|(_, device)| device).collect();
    for state in [AlState::SafeOp, AlState::PreOp, AlState::Init] {
        let asked = there.iter().map(|&&(station, _)| {
            let registers = context.registers.clone();
            async move { registers::lower(&registers, station, state, DOWN_LIMIT).await }
        });
        let mut results = at_once(context, asked).await.into_iter();
        // Who is silent is asked no further: the broadcast at the end is for all.
        there.retain(|(_, id)| {
            let Some(Err(error)) = results.next() else {
                return true;
            };
            let note = LogRecord::NotOnTheWayDown {
                drive: Arc::clone(id),
                state,
                error,
            };
            context.log.record(time.now(), note);
            !matches!(error, AlError::Register(_))
        });
        if state == AlState::SafeOp {
            // When the ports are dropped the handles show it.
            context.cycle.borrow_mut().take();
        }
    }
    // Who comes next finds the line as it is wired.
    let _ = running.connecting.give_ports_back().await;
    leave(context).await;
}

/// Sends everybody to INIT, whoever listens.
pub(in crate::bus) async fn leave(context: &Context) {
    context.cycle.borrow_mut().take();
    let reset = ethercrab::Command::bwr(esc::AL_CONTROL).ignore_wkc();
    let sent = reset.send(context.registers.main(), registers::RESET);
    let _ = context.time.within(DOWN_LIMIT, sent).await;
}
