//! Pitfalls 12 and 13 where a profile parameter is not in the process data: the handle writes it by an SDO that takes
//! its time.

use core::{
    future::Future,
    pin::{Pin, pin},
    sync::atomic::{AtomicUsize, Ordering},
    task::{Context, Poll, Waker},
    time::Duration,
};
use std::sync::{Arc, Mutex};

use servocrab::coe::{AxisOffset, DriveId, ObjectAddress, SdoError, Transfer, obj};
use servocrab::drives;
use servocrab::pdo_map::{Direction, Layout, Mapping};
use servocrab::units::AxisScale;
use servocrab::{
    Axis, Failure, Referencing, StopRequest,
    axis::{
        AxisCore, AxisFields, AxisIdentity, AxisPort, AxisSetup, AxisSource, BoxFuture, CoreConfig,
        Delivery, GroupQueue, Inputs, ParameterAccess,
    },
};
use servocrab::{Outcome, ProfilePosition, SetPoint};
use servocrab_sim::ds402::{self, Behaviour};

const CYCLE: Duration = Duration::from_millis(1);

/// Cycles from the request to the drive's confirmation.
const SDO_CYCLES: usize = 20;

type Drive = Arc<Mutex<ds402::Axis>>;

/// A mailbox: a write takes effect, and is confirmed, some cycles after it was asked for.
struct SlowSdo {
    drive: Drive,
    cycles: Arc<AtomicUsize>,
}

impl ParameterAccess for SlowSdo {
    fn write(&self, object: ObjectAddress, value: Vec<u8>) -> BoxFuture<'_, Result<(), SdoError>> {
        let mut due = None;
        Box::pin(core::future::poll_fn(move |_| {
            let now = self.cycles.load(Ordering::Relaxed);
            if now < *due.get_or_insert(now + SDO_CYCLES) {
                return Poll::Pending;
            }
            let mut raw = [0; 8];
            raw[..value.len()].copy_from_slice(&value);
            let mut drive = self.drive.lock().expect("no panic elsewhere");
            let set = drive.set(object.index, object.subindex, i64::from_le_bytes(raw));
            Poll::Ready(set.map_err(|_| SdoError::Closed {
                transfer: Transfer::write(object),
            }))
        }))
    }

    fn read(&self, object: ObjectAddress) -> BoxFuture<'_, Result<Vec<u8>, SdoError>> {
        Box::pin(async move {
            let drive = self.drive.lock().expect("no panic elsewhere");
            let value = drive
                .get(object.index, object.subindex)
                .ok_or(SdoError::Closed {
                    transfer: Transfer::read(object),
                })?;
            let bytes = if object.index == 0x6086 { 2 } else { 4 };
            Ok(value.to_le_bytes()[..bytes].to_vec())
        })
    }
}

/// One axis with its handles, without 6081h in the process data.
struct Station {
    core: AxisCore,
    port: AxisPort,
    source: AxisSource,
    drive: Drive,
    outputs: Vec<u8>,
    cycles: Arc<AtomicUsize>,
    layout: Layout,
}

impl Station {
    fn new(behaviour: Behaviour) -> Self {
        let layout = Mapping::builder()
            .rx_pdo(0x1600)
            .output(obj::CONTROLWORD)
            .output(obj::MODE_OF_OPERATION)
            .output(obj::TARGET_POSITION)
            .tx_pdo(0x1A00)
            .input(obj::STATUSWORD)
            .input(obj::MODE_OF_OPERATION_DISPLAY)
            .input(obj::POSITION_ACTUAL)
            .input(obj::VELOCITY_ACTUAL)
            .build()
            .expect("a mapping")
            .layout();
        let fields = AxisFields::from_layout(&layout, AxisOffset::default()).expect("all fields");
        let traits = drives::akd2g().traits;
        let mut config = CoreConfig::new(fields);
        config.referencing = Referencing::UnreferencedMovesAllowed;
        config.traits = traits;
        let core = AxisCore::new(config);
        let drive = Arc::new(Mutex::new(ds402::Axis::new(
            behaviour.with_plant(ds402::Plant::ideal()),
        )));
        let cycles = Arc::new(AtomicUsize::new(0));
        let (source, port) = AxisSetup {
            scale: AxisScale::COUNTS,
            identity: AxisIdentity {
                axis: "x".into(),
                drive: DriveId {
                    position: 0,
                    name: "AKD2G".into(),
                    identity: servocrab::sii::Identity::default(),
                },
            },
            offset: AxisOffset::default(),
            fields,
            layout: layout.clone(),
            error_texts: Arc::default(),
            parameters: Arc::new(SlowSdo {
                drive: Arc::clone(&drive),
                cycles: Arc::clone(&cycles),
            }),
            groups: GroupQueue::in_virtual_time(),
            index: 0,
        }
        .open(&core);
        Self {
            core,
            port,
            source,
            drive,
            outputs: vec![0; layout.output_bytes()],
            cycles,
            layout,
        }
    }

    /// An axis in Operation enabled, with its lease.
    fn ready(behaviour: Behaviour) -> (Self, Axis, ProfilePosition) {
        let mut station = Self::new(behaviour);
        for _ in 0..5 {
            station.cycle();
        }
        let axis = station.source.axis();
        station.finish(axis.enable()).expect("enabled");
        let lease = station.finish(axis.profile_position()).expect("the lease");
        (station, axis, lease)
    }

    fn cycle(&mut self) {
        let now = CYCLE * self.cycles.fetch_add(1, Ordering::Relaxed) as u32;
        self.port
            .before_send(&mut self.core, now, &mut self.outputs);
        let mut drive = self.drive.lock().expect("no panic elsewhere");
        let mut inputs = vec![0; self.layout.input_bytes()];
        for (object, place) in self.layout.objects(Direction::Inputs) {
            let value = drive.get(object.index, object.subindex).expect("it exists");
            let bytes = usize::from(place.bits / 8);
            inputs[place.byte..place.byte + bytes].copy_from_slice(&value.to_le_bytes()[..bytes]);
        }
        for (object, place) in self.layout.objects(Direction::Outputs) {
            let mut raw = [0; 4];
            let bytes = usize::from(place.bits / 8);
            raw[..bytes].copy_from_slice(&self.outputs[place.byte..place.byte + bytes]);
            drive
                .set(
                    object.index,
                    object.subindex,
                    i32::from_le_bytes(raw).into(),
                )
                .expect("it can be written");
        }
        self.core
            .step(now, Inputs::Fresh(&inputs), &mut self.outputs);
        self.port.after_step(&mut self.core, Some(&inputs));
        drive.cycle(now);
    }

    /// Runs until the future is ready.
    fn finish<T>(&mut self, future: impl Future<Output = T>) -> T {
        let mut future = pin!(future);
        for _ in 0..10_000 {
            if let Some(value) = poll(future.as_mut()) {
                return value;
            }
            self.cycle();
        }
        panic!("still not ready: {:?}", self.core.snapshot());
    }

    fn ledger(&self) -> Vec<ds402::Executed> {
        let drive = self.drive.lock().expect("no panic elsewhere");
        drive.ledger().to_vec()
    }
}

fn poll<F: Future>(future: Pin<&mut F>) -> Option<F::Output> {
    match future.poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => Some(value),
        Poll::Pending => None,
    }
}

#[test]
fn pitfall_12_a_parameter_written_by_sdo_is_confirmed_before_bit_4_rises() {
    let (mut station, _axis, pp) = Station::ready(Behaviour::akd2g());
    for velocity in [10_000, 20_000] {
        let target = i32::try_from(velocity).expect("small");
        let moved = station
            .finish(pp.move_abs(target, SetPoint::new().velocity(velocity)))
            .expect("it is taken");
        station.finish(moved.done()).expect("it arrives");
        let ledger = station.ledger();
        assert_eq!(ledger.last().map(|line| line.velocity), Some(velocity));
    }
    assert_eq!(station.ledger().len(), 2);
}

#[test]
fn pitfall_12_all_five_parameters_are_confirmed_before_bit_4_rises() {
    let behaviour = Behaviour {
        profile_types: &[0, 1],
        ..Behaviour::akd2g()
    };
    let (mut station, axis, pp) = Station::ready(behaviour);
    for (target, profile_type) in [(100_000_i32, 1), (-100_000, 0)] {
        let values = [
            target.unsigned_abs() / 5,
            700 + target.unsigned_abs() / 50_000,
            300_000,
            400_000,
        ];
        let set_point = SetPoint::new()
            .velocity(values[0])
            .end_velocity(values[1])
            .acceleration(values[2])
            .deceleration(values[3])
            .profile_type(profile_type);
        drop(
            station
                .finish(pp.move_abs(target, set_point))
                .expect("it is taken"),
        );
        let ledger = station.ledger();
        let line = ledger.last().expect("it was latched");
        let latched = [
            line.velocity,
            line.end_velocity,
            line.acceleration,
            line.deceleration,
        ];
        assert_eq!((line.value, latched), (target, values));
        assert_eq!(line.profile_type, profile_type);
        station.finish(axis.stop()).expect("it stands");
        station.finish(axis.enable()).expect("enabled");
    }
}

#[test]
fn pitfall_12_no_parameter_of_another_move_comes_between_a_write_and_its_edge() {
    // The drive looks at a set-point later than an SDO write takes.
    let behaviour = Behaviour {
        bit_4_filter_cycles: 3 * SDO_CYCLES as u32,
        ..Behaviour::akd2g()
    };
    let (mut station, _axis, pp) = Station::ready(behaviour);
    let velocities = [10_000, 20_000, 30_000];
    let both = async {
        let moves = velocities.map(|velocity| {
            let target = i32::try_from(velocity).expect("small");
            Box::pin(pp.move_abs(target, SetPoint::new().velocity(velocity)))
        });
        let mut taken = [const { None }; 3];
        let mut moves = moves;
        core::future::poll_fn(|_| {
            for (result, moving) in taken.iter_mut().zip(&mut moves) {
                if result.is_none() {
                    *result = poll(moving.as_mut());
                }
            }
            if taken.iter().all(Option::is_some) {
                Poll::Ready(())
            } else {
                Poll::Pending
            }
        })
        .await;
        taken
    };
    for taken in station.finish(both) {
        assert!(matches!(taken, Some(Ok(_))), "{taken:?}");
    }
    let mut sent: Vec<_> = station
        .ledger()
        .iter()
        .map(|line| (line.value, line.velocity))
        .collect();
    sent.sort_unstable();
    assert_eq!(sent, [(10_000, 10_000), (20_000, 20_000), (30_000, 30_000)]);
}

#[test]
fn pitfall_13_a_move_resolves_when_the_drive_has_taken_it_and_not_before() {
    let (mut station, _axis, pp) = Station::ready(Behaviour::akd2g());
    {
        let mut drive = station.drive.lock().expect("no panic elsewhere");
        drive.disturbances().ack_delay_cycles = 50;
    }
    let mut moving = pin!(pp.move_abs(1_000, SetPoint::new()));
    for _ in 0..40 {
        assert!(poll(moving.as_mut()).is_none());
        station.cycle();
    }
    assert_eq!(station.ledger().len(), 1, "taken and not acknowledged");
    let moved = station.finish(moving).expect("it is acknowledged");
    assert_eq!(
        station.finish(moved.done()).expect("it arrives"),
        Outcome::Reached { position: 1_000 }
    );
}

#[test]
fn pitfall_19_a_move_whose_parameters_are_still_being_written_does_not_outlive_a_stop() {
    type Stop = fn(&mut Station, &Axis);
    let stops: [(Stop, Failure); 5] = [
        (
            |_, axis| axis.stop_handle().stop(),
            Failure::QuickStopped {
                delivery: Delivery::NotSent,
            },
        ),
        (
            |station, axis| {
                station.finish(axis.stop()).expect("it stands");
            },
            Failure::QuickStopped {
                delivery: Delivery::NotSent,
            },
        ),
        (
            |station, _| station.port.request_stop(StopRequest::STOP),
            Failure::QuickStopped {
                delivery: Delivery::NotSent,
            },
        ),
        (
            |station, axis| {
                station.finish(axis.halt()).expect("halted");
                station.finish(axis.resume()).expect("resumed");
            },
            Failure::Halted {
                delivery: Delivery::NotSent,
            },
        ),
        (
            |station, axis| {
                station.finish(axis.quick_stop()).expect("stopped");
                station.finish(axis.enable()).expect("enabled");
            },
            Failure::QuickStopped {
                delivery: Delivery::NotSent,
            },
        ),
    ];
    for (stop, why) in stops {
        let (mut station, axis, pp) = Station::ready(Behaviour::akd2g());
        let mut moving = pin!(pp.move_abs(5_000, SetPoint::new().velocity(10_000)));
        for _ in 0..3 {
            assert!(poll(moving.as_mut()).is_none());
            station.cycle();
        }
        stop(&mut station, &axis);
        let error = station.finish(moving).expect_err("it was stopped");
        assert_eq!(error.failure(), Some(why));
        assert!(station.ledger().is_empty(), "nothing moved after the stop");
        // A stop is over when the axis is known to stand.
        for _ in 0..200 {
            station.cycle();
        }
        let later = station.finish(pp.move_abs(5_000, SetPoint::new().velocity(10_000)));
        let later = later.expect("a move that is asked for after the stop is executed");
        station.finish(later.done()).expect("it arrives");
    }
}
