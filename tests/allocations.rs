//! The bus loop in steady state allocates and frees nothing: it is turned 100 000 cycles long in virtual time under a counting
//! allocator, with moves under way, while statistics are read. (SDO transfers do allocate: their mails and replies.)
//! `SHOW_ALLOCATIONS=1` prints where each one came from.
#![allow(missing_docs, unsafe_code)]

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    future::Future,
    pin::pin,
    sync::{Arc, Mutex},
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    axis::Referencing,
    bus::{BusLoop, DriveConfig, Network},
    drives,
    link::Wire,
    profile_position::SetPoint,
};
use servocrab_sim::{Segment, personality};

thread_local! {
    /// Allocations and frees of this thread outside the simulated segment, while they are counted.
    static COUNTED: Cell<u64> = const { Cell::new(0) };
    static COUNTING: Cell<bool> = const { Cell::new(false) };
}

struct Counting;

fn count() {
    // Fails only while the thread ends.
    let _ = COUNTING.try_with(|counting| {
        if counting.get() {
            let _ = COUNTED.try_with(|counted| counted.set(counted.get() + 1));
            counting.set(false);
            if std::env::var_os("SHOW_ALLOCATIONS").is_some() {
                eprintln!("{}", std::backtrace::Backtrace::force_capture());
            }
            counting.set(true);
        }
    });
}

// SAFETY: every call goes to the system's allocator as it came; counting touches only thread-local cells without destructors.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller promised.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        count();
        // SAFETY: as the caller promised.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as the caller promised.
        unsafe { System.realloc(memory, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const CYCLES: u64 = 100_000;

fn until<T>(bus: &mut BusLoop, future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    loop {
        if let Poll::Ready(value) = future
            .as_mut()
            .poll(&mut Context::from_waker(Waker::noop()))
        {
            return value;
        }
        assert!(bus.turn());
    }
}

/// Allocations and frees of the loop until the network has gone through this many more cycles.
fn allocations(net: &Network, bus: &mut BusLoop, cycles: u64) -> u64 {
    let end = net.statistics().cycles + cycles;
    COUNTED.set(0);
    COUNTING.set(true);
    while net.statistics().cycles < end {
        assert!(bus.turn());
    }
    COUNTING.set(false);
    COUNTED.get()
}

#[test]
fn a_hundred_thousand_cycles_with_moves_allocate_and_free_nothing() {
    let segment = Segment::new()
        .with(personality::akd2g())
        .with(personality::akd2g());
    let segment = Arc::new(Mutex::new(segment));
    let wire = Wire::in_virtual_time(Duration::from_micros(10), move |frame: &mut [u8], now| {
        let counting = COUNTING.replace(false);
        let back = segment.lock().unwrap().process(frame, now);
        COUNTING.set(counting);
        back
    });
    let drive = |name| {
        DriveConfig::new(drives::akd2g())
            .axis(name)
            .referencing(name, Referencing::UnreferencedMovesAllowed)
    };
    let (starting, mut bus) = Network::builder()
        .link(wire)
        .drive(0, drive("x"))
        .drive(1, drive("y"))
        .split()
        .unwrap();
    let net = until(&mut bus, starting.network()).unwrap();
    let axis = net.axis("x").unwrap();
    until(&mut bus, axis.enable()).unwrap();
    let pp = until(&mut bus, axis.profile_position()).unwrap();
    let set_point = SetPoint::new()
        .velocity(100_000)
        .acceleration(1_000_000)
        .deceleration(1_000_000);
    // Buffers reach their size.
    let _ = allocations(&net, &mut bus, 5_000);
    let mut counted = 0;
    let mut target = 0;
    for _ in 0..CYCLES / 1_000 {
        target = 20_000 - target;
        let moved = until(&mut bus, pp.move_abs(target, set_point)).unwrap();
        let mut done = pin!(moved.done());
        let mut context = Context::from_waker(Waker::noop());
        assert!(done.as_mut().poll(&mut context).is_pending());
        counted += allocations(&net, &mut bus, 500);
        assert!(net.timing().round_trip.count() > 0);
        assert!(net.drive_statistics().len() == 2);
        counted += allocations(&net, &mut bus, 500);
        assert!(matches!(
            done.as_mut().poll(&mut context),
            Poll::Ready(Ok(_))
        ));
    }
    assert_eq!(counted, 0, "allocations and frees in {CYCLES} cycles");
}
