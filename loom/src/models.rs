//! The models.

use std::{
    future::Future,
    pin::pin,
    sync::{
        Arc as StdArc,
        atomic::{AtomicU32 as StdAtomicU32, Ordering::SeqCst},
    },
    task::{Context, Poll, Wake, Waker},
};

use loom::thread;
use servocrab::{
    Failure,
    axis::{Completion, Snapshot},
    ds402::{Controlword, Mode, Statusword},
};

use crate::{
    axis::{OneRequest, Outputs, Status},
    bus::Inputs,
    sync::{Arc, AtomicU64, Ordering},
    wakes::Shared,
};

/// All of them, by what they show.
pub(crate) const ALL: [(&str, fn()); 10] = [
    ("waiters: no ring is lost", no_ring_is_lost),
    ("waiters: nor where two wait", two_futures_are_both_woken),
    ("waiters: nor at the end", the_end_loses_no_ring),
    ("status cell: no mixture", no_status_is_a_mixture),
    (
        "output cells: the last one set",
        the_output_set_last_is_sent,
    ),
    ("input cell: no mixture", no_inputs_are_a_mixture),
    ("stop: none is lost", a_halt_is_asked_for_while_one_ends),
    (
        "stop: nor by a failure",
        a_halt_is_asked_for_while_one_fails,
    ),
    ("stop: who waits is told", one_leaves_while_a_halt_fails),
    ("request: given up or taken", a_request_is_given_up_or_taken),
];

struct Woken(StdAtomicU32);

impl Wake for Woken {
    fn wake(self: StdArc<Self>) {
        self.0.fetch_add(1, SeqCst);
    }
}

/// A future of the program that waits for a value: whether it was ready, or else was woken.
fn wait_once(shared: &Shared, value: &AtomicU64) -> (bool, StdArc<Woken>) {
    let woken = StdArc::new(Woken(StdAtomicU32::new(0)));
    let waker = Waker::from(StdArc::clone(&woken));
    let ready = || (value.load(Ordering::Acquire) == 1).then_some(());
    // It is not dropped before its thread is: it waits on.
    let future = std::mem::ManuallyDrop::new(Box::pin(shared.waiters.until(3, ready)));
    let mut future = future;
    let polled = future.as_mut().poll(&mut Context::from_waker(&waker));
    (polled == Poll::Ready(()), woken)
}

/// The bus thread stores and rings; another one wakes at the same time.
fn no_ring_is_lost() {
    let shared = Shared::new();
    let value = Arc::new(AtomicU64::new(0));
    let bus = {
        let (shared, value) = (shared.clone(), Arc::clone(&value));
        thread::spawn(move || {
            value.store(1, Ordering::Release);
            shared.waiters.announce(3);
        })
    };
    let waking = {
        let shared = shared.clone();
        thread::spawn(move || shared.wake_rung())
    };
    let (ready, woken) = wait_once(&shared, &value);
    bus.join().unwrap();
    waking.join().unwrap();
    shared.wake_rung();
    assert!(ready || woken.0.load(SeqCst) > 0, "it waits for ever");
}

fn two_futures_are_both_woken() {
    let shared = Shared::new();
    let value = Arc::new(AtomicU64::new(0));
    let other = {
        let (shared, value) = (shared.clone(), Arc::clone(&value));
        thread::spawn(move || wait_once(&shared, &value))
    };
    let bus = {
        let (shared, value) = (shared.clone(), Arc::clone(&value));
        thread::spawn(move || {
            value.store(1, Ordering::Release);
            shared.waiters.announce(3);
            shared.wake_rung();
        })
    };
    let mine = wait_once(&shared, &value);
    let others = other.join().unwrap();
    bus.join().unwrap();
    shared.wake_rung();
    for (ready, woken) in [mine, others] {
        assert!(ready || woken.0.load(SeqCst) > 0, "it waits for ever");
    }
}

/// Whoever rings while the loop ends: the last look sees it, or whoever rings wakes.
fn the_end_loses_no_ring() {
    let shared = Shared::new();
    let value = Arc::new(AtomicU64::new(0));
    let (ready, woken) = wait_once(&shared, &value);
    assert!(!ready);
    let ending = {
        let shared = shared.clone();
        thread::spawn(move || shared.end())
    };
    value.store(1, Ordering::Release);
    shared.waiters.announce(3);
    ending.join().unwrap();
    assert!(woken.0.load(SeqCst) > 0, "it waits for ever");
}

fn snapshot(cycle: u64) -> Snapshot {
    let statusword = Statusword::from_bits_retain(cycle as u16);
    Snapshot {
        cycle,
        age: cycle as u32,
        answered: true,
        lost: false,
        statusword,
        state: statusword.state(),
        controlword: Controlword::from_bits_retain(cycle as u16),
        mode: Mode::from_raw(cycle as i8),
        position: cycle as i32,
        velocity: -(cycle as i32),
        following_error: None,
        torque: None,
        error_code: None,
        halted: false,
        has_set_point: false,
        referenced: false,
        slipped: false,
    }
}

fn no_status_is_a_mixture() {
    let status = Arc::new(Status::new(&snapshot(0)));
    let bus = {
        let status = Arc::clone(&status);
        thread::spawn(move || {
            for cycle in 1..=2 {
                status.publish(&snapshot(cycle), [cycle as u8; 8]);
            }
        })
    };
    let seen = status.read();
    assert_eq!(seen, snapshot(seen.cycle));
    let bytes = status.inputs();
    assert!(bytes.iter().all(|byte| *byte == bytes[0]), "{bytes:?}");
    assert!(u64::from(bytes[0]) >= seen.cycle, "time does not go back");
    bus.join().unwrap();
}

fn the_output_set_last_is_sent() {
    let outputs = Arc::new(Outputs::new());
    let program = {
        let outputs = Arc::clone(&outputs);
        thread::spawn(move || {
            outputs.set(1);
            outputs.set(2);
        })
    };
    let mut frame = Vec::new();
    let mut last = 0;
    for _ in 0..2 {
        let sent = outputs.merge_into(&mut frame);
        assert!(sent >= last, "what was set before comes after it");
        last = sent;
    }
    program.join().unwrap();
    assert_eq!(outputs.merge_into(&mut frame), 2);
}

fn no_inputs_are_a_mixture() {
    let inputs = Arc::new(Inputs::new());
    let bus = {
        let inputs = Arc::clone(&inputs);
        thread::spawn(move || {
            for cycle in 1..=2 {
                inputs.publish(cycle);
            }
        })
    };
    let (cycle, bytes) = inputs.read();
    assert_eq!(bytes, [cycle as u8; 8]);
    bus.join().unwrap();
}

/// Another handle halts the axis while the first halt ends with this.
fn halt_again(first: Result<Completion, Failure>) {
    let halt = Arc::new(OneRequest::halt());
    let program = {
        let halt = Arc::clone(&halt);
        thread::spawn(move || halt.join())
    };
    let carried_out = halt.carry_out(first);
    let (joined, asked) = program.join().unwrap();
    assert!(halt.result().is_some(), "it has ended");
    assert!(
        !joined || carried_out == asked,
        "who shares the halt has asked for it in vain"
    );
}

fn a_halt_is_asked_for_while_one_ends() {
    halt_again(Ok(Completion::Done));
}

fn a_halt_is_asked_for_while_one_fails() {
    halt_again(Err(Failure::HaltIgnored));
}

/// A halt that nobody waits for goes on to the quick stop when it fails: here one waits to the end.
fn one_leaves_while_a_halt_fails() {
    let halt = Arc::new(OneRequest::halt());
    let program = {
        let halt = Arc::clone(&halt);
        thread::spawn(move || {
            if halt.join().0 {
                halt.leave();
            }
        })
    };
    halt.carry_out(Err(Failure::HaltIgnored));
    assert!(halt.is_waited_for(), "one still waits");
    assert_eq!(halt.result(), Some(Err(Failure::HaltIgnored)));
    program.join().unwrap();
}

/// The parameters of a request that is over are another one's.
fn a_request_is_given_up_or_taken() {
    let request = Arc::new(OneRequest::question());
    let program = {
        let request = Arc::clone(&request);
        thread::spawn(move || request.give_up())
    };
    let taken = request.take();
    let withdrawn = request.is_withdrawn();
    let is_over = program.join().unwrap();
    assert_eq!(is_over, !taken, "it is given up, or the core has it");
    // The next cycle looks again.
    assert_eq!(withdrawn | request.is_withdrawn(), taken);
}
