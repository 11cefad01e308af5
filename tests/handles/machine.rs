//! Axes with their handles' ports, each on a simulated drive of its own, stepped together in virtual time, and futures
//! that are polled by hand, only when they were woken.

use core::{
    future::Future,
    pin::Pin,
    task::{Context, Poll, Waker},
    time::Duration,
};
use std::{
    sync::{
        Arc, Mutex, MutexGuard,
        atomic::{AtomicBool, Ordering},
    },
    task::Wake,
};

use servocrab::{
    Axis, Outcome, Referencing,
    axis::{
        AxisCore, AxisFields, AxisIdentity, AxisPort, AxisSet, AxisSetup, AxisSource, BoxFuture,
        CoreConfig, GroupQueue, Groups, Inputs, ParameterAccess,
    },
    coe::{AbortCode, AnyObject, AxisOffset, DriveId, ObjectAddress, SdoError, Transfer, obj},
    drives,
    ds402::StopOptions,
    pdo_map::{Direction, Layout, Mapping},
    profile_position::{Limits, Parameters, PositionRange, Traits},
    units::AxisScale,
};
use servocrab_sim::ds402;

pub(crate) const CYCLE: Duration = Duration::from_millis(1);

/// A move ends, and an axis rests, within so many counts of its target: 6067h of the drive.
const WINDOW: i64 = 10;
/// An axis on its way has its demand velocity within so many counts/s.
const FOLLOWS: f64 = 500.0;

pub(crate) type Drive = Arc<Mutex<ds402::Axis>>;

pub(crate) struct Station {
    /// No outputs come to it.
    pub(crate) deaf: bool,
    /// Nothing comes back from it.
    pub(crate) silent: bool,
    /// Bits that the next statusword lacks.
    pub(crate) lacks: u16,
    pub(crate) core: AxisCore,
    pub(crate) port: Option<AxisPort>,
    pub(crate) source: AxisSource,
    pub(crate) drive: Drive,
    pub(crate) outputs: Vec<u8>,
    /// The controlword of every frame sent.
    pub(crate) words: Vec<u16>,
    /// The outputs of every frame sent.
    pub(crate) frames: Vec<Vec<u8>>,
    pub(crate) sdo: Arc<Sdo>,
    layout: Layout,
    drive_cycle: u32,
}

pub(crate) struct Machine {
    pub(crate) stations: Vec<Station>,
    pub(crate) now: Duration,
    /// Nothing comes back while this is set.
    pub(crate) silent: bool,
    pub(crate) groups: Groups,
}

/// What differs from an AKD2G with its default mapping.
#[derive(Clone)]
pub(crate) struct Variant {
    pub(crate) not_mapped: Vec<u16>,
    pub(crate) mapped_too: Vec<AnyObject>,
    pub(crate) inputs_too: Vec<AnyObject>,
    /// How many cycles of the bus one of the drive's is.
    pub(crate) drive_cycle: u32,
    pub(crate) modulo: Option<PositionRange>,
    pub(crate) behaviour: ds402::Behaviour,
    pub(crate) traits: Traits,
    pub(crate) limits: Limits,
    pub(crate) referencing: Referencing,
    pub(crate) scale: AxisScale,
    pub(crate) stop_options: StopOptions,
}

impl Default for Variant {
    fn default() -> Self {
        Self {
            not_mapped: Vec::new(),
            mapped_too: Vec::new(),
            inputs_too: Vec::new(),
            drive_cycle: 1,
            modulo: None,
            behaviour: ds402::Behaviour::akd2g(),
            traits: drives::akd2g().traits,
            limits: Limits::trust_drive(),
            referencing: Referencing::AbsoluteEncoder,
            scale: AxisScale::COUNTS,
            stop_options: StopOptions::default(),
        }
    }
}

impl Variant {
    /// Speeds and ramps go by SDO, and it can jog and home.
    pub(crate) fn by_sdo() -> Self {
        Self {
            not_mapped: vec![0x6081, 0x6083, 0x6084],
            mapped_too: vec![obj::TARGET_VELOCITY.into()],
            behaviour: ds402::Behaviour {
                machine: beside_its_switch(),
                ..ds402::Behaviour::akd2g()
            },
            referencing: Referencing::UnreferencedMovesAllowed,
            ..Self::default()
        }
    }
}

/// The home switch lies in negative direction, 5000 counts away.
pub(crate) fn beside_its_switch() -> ds402::Machine {
    ds402::Machine {
        start: 20_000,
        negative_limit: Some(15_000),
        ..ds402::Machine::default()
    }
}

/// SDO access that goes straight to the drive's objects, and remembers what was asked.
pub(crate) struct Sdo {
    drive: Drive,
    pub(crate) written: Mutex<Vec<(u16, Vec<u8>)>>,
    pub(crate) refuse: AtomicBool,
    /// A read takes at least a cycle.
    pub(crate) slow: AtomicBool,
    /// A write takes at least a poll.
    pub(crate) slow_writes: AtomicBool,
    /// Its answer comes a poll after it has taken effect.
    pub(crate) late_answers: AtomicBool,
    /// An object that reads as 0, whatever the drive holds.
    pub(crate) zero: Mutex<Option<ObjectAddress>>,
}

impl ParameterAccess for Sdo {
    fn write(&self, object: ObjectAddress, value: Vec<u8>) -> BoxFuture<'_, Result<(), SdoError>> {
        Box::pin(async move {
            if self.slow_writes.load(Ordering::Relaxed) {
                smol::future::yield_now().await;
            }
            if self.refuse.load(Ordering::Relaxed) {
                return Err(SdoError::Aborted {
                    transfer: Transfer::write(object),
                    code: AbortCode::PRESENT_STATE,
                });
            }
            let number = number(object.index, &value);
            let set = lock(&self.drive).set(object.index, object.subindex, number);
            if set.is_err() {
                return Err(SdoError::Aborted {
                    transfer: Transfer::write(object),
                    code: AbortCode(0x0609_0030),
                });
            }
            self.written.lock().unwrap().push((object.index, value));
            if self.late_answers.load(Ordering::Relaxed) {
                smol::future::yield_now().await;
            }
            Ok(())
        })
    }

    fn read(&self, object: ObjectAddress) -> BoxFuture<'_, Result<Vec<u8>, SdoError>> {
        Box::pin(async move {
            if self.slow.load(Ordering::Relaxed) {
                smol::future::yield_now().await;
            }
            let Some(value) = lock(&self.drive).get(object.index, object.subindex) else {
                return Err(SdoError::Aborted {
                    transfer: Transfer::read(object),
                    code: AbortCode::NO_OBJECT,
                });
            };
            let zero = *self.zero.lock().unwrap() == Some(object);
            let value = if zero { 0 } else { value };
            let bytes = match object.index {
                0x6061 => 1,
                0x603F | 0x6072 | 0x6086 | 0x60B8 | 0x60B9 | 0x60D5..=0x60D8 => 2,
                _ => 4,
            };
            Ok(value.to_le_bytes()[..bytes].to_vec())
        })
    }
}

pub(crate) fn lock(drive: &Drive) -> MutexGuard<'_, ds402::Axis> {
    drive.lock().unwrap()
}

impl Machine {
    /// With this many axes, each on its own drive, in Switch on disabled.
    pub(crate) fn new(axes: usize) -> Self {
        Self::of(axes, &Variant::default())
    }

    pub(crate) fn of(axes: usize, variant: &Variant) -> Self {
        let queue = GroupQueue::in_virtual_time();
        let mut machine = Self {
            stations: (0..axes)
                .map(|index| Station::new(index, &queue, variant))
                .collect(),
            now: Duration::ZERO,
            silent: false,
            groups: queue.groups(),
        };
        machine.run(5);
        machine
    }

    /// One axis in Operation enabled.
    pub(crate) fn enabled() -> (Self, Axis) {
        Self::enabled_of(&Variant::default())
    }

    /// One axis of this kind in Operation enabled.
    pub(crate) fn enabled_of(variant: &Variant) -> (Self, Axis) {
        let mut machine = Self::of(1, variant);
        let axis = machine.axis(0);
        machine.finish(axis.enable()).unwrap();
        (machine, axis)
    }

    pub(crate) fn axis(&self, index: usize) -> Axis {
        self.stations[index].source.axis()
    }

    pub(crate) fn drive(&self) -> MutexGuard<'_, ds402::Axis> {
        lock(&self.stations[0].drive)
    }

    /// Whether the shaft is within the position window around this position.
    pub(crate) fn is_at(&self, position: i64) -> bool {
        (self.drive().position() - position).abs() <= WINDOW
    }

    /// Whether the shaft goes at this demand velocity.
    pub(crate) fn goes_at(&self, velocity: f64) -> bool {
        let drive = self.drive();
        drive.demand().1 == velocity && (drive.velocity() - velocity).abs() < FOLLOWS
    }

    /// Whether the drive plans no motion, and its shaft stands.
    pub(crate) fn stands(&self) -> bool {
        self.drive().stands()
    }

    pub(crate) fn cycle(&mut self) {
        self.cycle_while(|| ());
    }

    /// One cycle, with something that the program does while the frame is under way.
    pub(crate) fn cycle_while(&mut self, under_way: impl FnOnce()) {
        self.cycle_with(0, || (), under_way);
    }

    /// One cycle, with something that the program does when commands were taken from the axes before this one alone.
    pub(crate) fn cycle_between(&mut self, axis: usize, taken: impl FnOnce()) {
        self.cycle_with(axis, taken, || ());
    }

    fn cycle_with(&mut self, axis: usize, taken: impl FnOnce(), under_way: impl FnOnce()) {
        self.now += CYCLE;
        let now = self.now;
        let (before, behind) = self.stations.split_at_mut(axis);
        before.iter_mut().for_each(|station| station.take(now));
        taken();
        behind.iter_mut().for_each(|station| station.take(now));
        self.groups.advance(now, &mut Stations(&mut self.stations));
        under_way();
        for station in &mut self.stations {
            station.exchange(now, self.silent);
        }
    }

    pub(crate) fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.cycle();
        }
    }

    /// Runs until the future is ready.
    pub(crate) fn finish<T>(&mut self, future: impl Future<Output = T>) -> T {
        let mut task = Task::new(future);
        self.finish_task(&mut task)
    }

    /// Runs so many cycles, in each of which the task is polled and does not end.
    #[track_caller]
    pub(crate) fn run_beside<T>(&mut self, task: &mut Task<'_, T>, cycles: usize) {
        for _ in 0..cycles {
            assert!(task.poll().is_none());
            self.cycle();
        }
    }

    pub(crate) fn finish_task<T>(&mut self, task: &mut Task<'_, T>) -> T {
        for _ in 0..30_000 {
            if let Some(value) = task.poll() {
                return value;
            }
            self.cycle();
        }
        panic!("still not ready: {:?}", self.stations[0].core.snapshot());
    }
}

/// The outcome of a move that has reached this target, by its position window.
#[track_caller]
pub(crate) fn at_target(outcome: Outcome, target: i32) -> Outcome {
    let Outcome::Reached { position } = outcome else {
        panic!("{outcome:?} instead of {target} reached");
    };
    let off = i64::from(position) - i64::from(target);
    assert!(off.abs() <= WINDOW, "at {position} instead of {target}");
    outcome
}

struct Stations<'a>(&'a mut [Station]);

impl AxisSet for Stations<'_> {
    fn axis(&mut self, index: usize) -> Option<(&mut AxisCore, &mut [u8])> {
        let station = self.0.get_mut(index)?;
        Some((&mut station.core, &mut station.outputs))
    }
}

impl Station {
    fn new(index: usize, queue: &GroupQueue, variant: &Variant) -> Self {
        let layout = layout(variant);
        let fields = AxisFields::from_layout(&layout, AxisOffset::default()).unwrap();
        let mut config = CoreConfig::new(fields);
        config.referencing = variant.referencing;
        config.traits = variant.traits;
        config.traits.drive_cycle = config.traits.drive_cycle.max(CYCLE * variant.drive_cycle);
        config.modulo = variant.modulo;
        config.limits = variant.limits;
        config.stop_options = variant.stop_options;
        config.defaults = Parameters {
            velocity: Some(50_000),
            acceleration: Some(500_000),
            deceleration: Some(500_000),
            ..Parameters::default()
        };
        let core = AxisCore::new(config);
        let mut behaviour = variant.behaviour.clone();
        // Each shaft has noise and loads of its own.
        behaviour.plant.seed += index as u64;
        let drive: Drive = Arc::new(Mutex::new(ds402::Axis::new(behaviour)));
        let sdo = Arc::new(Sdo {
            drive: Arc::clone(&drive),
            written: Mutex::default(),
            refuse: AtomicBool::new(false),
            slow: AtomicBool::new(false),
            slow_writes: AtomicBool::new(false),
            late_answers: AtomicBool::new(false),
            zero: Mutex::default(),
        });
        let setup = AxisSetup {
            scale: variant.scale,
            identity: AxisIdentity {
                axis: format!("axis{index}"),
                drive: DriveId {
                    position: index as u16,
                    name: "AKD2G".into(),
                    identity: servocrab::sii::Identity::default(),
                },
            },
            offset: AxisOffset::default(),
            fields,
            layout: layout.clone(),
            error_texts: Arc::default(),
            parameters: sdo.clone(),
            groups: queue.clone(),
            index,
        };
        let (source, port) = setup.open(&core);
        Self {
            core,
            port: Some(port),
            source,
            drive,
            outputs: vec![0; layout.output_bytes()],
            words: Vec::new(),
            frames: Vec::new(),
            deaf: false,
            silent: false,
            lacks: 0,
            sdo,
            layout,
            drive_cycle: variant.drive_cycle,
        }
    }

    fn take(&mut self, now: Duration) {
        if let Some(port) = &mut self.port {
            port.before_send(&mut self.core, now, &mut self.outputs);
        }
    }

    fn exchange(&mut self, now: Duration, silent: bool) {
        self.words
            .push(u16::from_le_bytes([self.outputs[0], self.outputs[1]]));
        self.frames.push(self.outputs.clone());
        let mut drive = self.drive.lock().unwrap();
        let mut inputs = vec![0; self.layout.input_bytes()];
        for (object, place) in self.layout.objects(Direction::Inputs) {
            let mut value = drive.get(object.index, object.subindex).unwrap();
            if object.index == 0x6041 {
                value &= !i64::from(core::mem::take(&mut self.lacks));
            }
            let bytes = usize::from(place.bits / 8);
            inputs[place.byte..place.byte + bytes].copy_from_slice(&value.to_le_bytes()[..bytes]);
        }
        for (object, place) in self.layout.objects(Direction::Outputs) {
            if self.deaf {
                break;
            }
            let bytes = usize::from(place.bits / 8);
            let value = number(object.index, &self.outputs[place.byte..place.byte + bytes]);
            // What the drive refuses stays what it was, as with a PDO.
            let _ = drive.set(object.index, object.subindex, value);
        }
        let arrived = (!silent && !self.silent).then_some(inputs.as_slice());
        let fresh = arrived.map_or(Inputs::Stale, Inputs::Fresh);
        self.core.step(now, fresh, &mut self.outputs);
        if let Some(port) = &mut self.port {
            port.after_step(&mut self.core, arrived);
        }
        if (now.as_millis() as u32).is_multiple_of(self.drive_cycle) {
            drive.cycle(now);
        }
    }
}

/// Enabled, with the parameters of its motions by SDO, each write of which takes a while.
pub(crate) fn slow() -> (Machine, Axis) {
    let (machine, axis) = Machine::enabled_of(&Variant::by_sdo());
    let sdo = &machine.stations[0].sdo;
    sdo.slow_writes.store(true, Ordering::Relaxed);
    (machine, axis)
}

/// Until it writes its parameters, and is polled no more there.
pub(crate) fn kept<T>(machine: &mut Machine, task: &mut Task<'_, T>) {
    let written = |machine: &Machine| machine.stations[0].sdo.written.lock().unwrap().len();
    let before = written(machine);
    while written(machine) == before {
        assert!(task.poll().is_none());
        machine.cycle();
    }
}

/// An object's value from its bytes.
fn number(index: u16, bytes: &[u8]) -> i64 {
    let mut raw = [0; 8];
    raw[..bytes.len()].copy_from_slice(bytes);
    let number = i64::from_le_bytes(raw);
    match index {
        0x607A | 0x607C | 0x60FF => i64::from(number as i32),
        0x6060 | 0x6098 => i64::from(number as i8),
        _ => number,
    }
}

/// What a frame's outputs hold of an object, as it lies there.
pub(crate) fn output(station: &Station, frame: &[u8], index: u16) -> i32 {
    let place = station
        .layout
        .find(Direction::Outputs, index, 0)
        .expect("it is mapped");
    let bytes = usize::from(place.bits / 8);
    number(index, &frame[place.byte..place.byte + bytes]) as i32
}

fn layout(variant: &Variant) -> Layout {
    let mapped = |objects: &[AnyObject]| -> Vec<AnyObject> {
        let all = objects.iter().copied();
        all.filter(|object| !variant.not_mapped.contains(&object.index))
            .collect()
    };
    let outputs = mapped(&[
        obj::CONTROLWORD.into(),
        obj::MODE_OF_OPERATION.into(),
        obj::TARGET_POSITION.into(),
        obj::PROFILE_VELOCITY.into(),
        obj::PROFILE_ACCELERATION.into(),
        obj::PROFILE_DECELERATION.into(),
        obj::DIGITAL_OUTPUTS.into(),
    ]);
    let inputs = mapped(&[
        obj::STATUSWORD.into(),
        obj::MODE_OF_OPERATION_DISPLAY.into(),
        obj::POSITION_ACTUAL.into(),
        obj::VELOCITY_ACTUAL.into(),
        obj::DIGITAL_INPUTS.into(),
    ]);
    let mut builder = Mapping::builder().rx_pdo(0x1600);
    for object in outputs.into_iter().chain(variant.mapped_too.clone()) {
        builder = builder.object(Direction::Outputs, object);
    }
    builder = builder.tx_pdo(0x1A00);
    for object in inputs.into_iter().chain(variant.inputs_too.clone()) {
        builder = builder.object(Direction::Inputs, object);
    }
    builder.build().unwrap().layout()
}

/// A future that is polled only when it was woken: one whose waking is forgotten never ends.
pub(crate) struct Task<'a, T> {
    future: Pin<Box<dyn Future<Output = T> + 'a>>,
    woken: Arc<Woken>,
}

struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Release);
    }
}

impl<'a, T> Task<'a, T> {
    pub(crate) fn new(future: impl Future<Output = T> + 'a) -> Self {
        Self {
            future: Box::pin(future),
            woken: Arc::new(Woken(AtomicBool::new(true))),
        }
    }

    pub(crate) fn poll(&mut self) -> Option<T> {
        if !self.woken.0.swap(false, Ordering::AcqRel) {
            return None;
        }
        let waker = Waker::from(Arc::clone(&self.woken));
        match self.future.as_mut().poll(&mut Context::from_waker(&waker)) {
            Poll::Ready(value) => Some(value),
            Poll::Pending => None,
        }
    }
}
