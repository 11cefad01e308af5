//! The library's raw socket by itself, with a bare one at the other end of a veth pair.
//!
//! The tests run again inside a network namespace of their own. Where none can be made they say so and pass, but fail when
//! `CI=true`.

use std::time::Duration;

use crate::namespace::{inside_namespace, run};
use servocrab::link::{Link, RawSocket, RawSocketError};
use servocrab_sim::link::RawSocket as Bare;

const SECOND: Duration = Duration::from_secs(1);

/// The two ends of the cable, the near one as a network has it in its cycles.
fn ends() -> (RawSocket, Bare) {
    let (mut near, far) = unprepared();
    near.prepare().expect("a ring can be had");
    (near, far)
}

fn unprepared() -> (RawSocket, Bare) {
    let near = RawSocket::open("master0").expect("the interface is there");
    let far = Bare::open("slave0").expect("the interface is there");
    (near, far)
}

/// A frame that is told from others by its number.
fn frame(number: usize, length: usize) -> Vec<u8> {
    let mut frame: Vec<u8> = (0..length).map(|at| (at + number) as u8).collect();
    frame[..6].fill(0xFF);
    frame[6] = 0x12;
    frame[12..14].copy_from_slice(&0x88A4u16.to_be_bytes());
    frame
}

/// Receives what must be on its way.
fn next(near: &mut RawSocket, buffer: &mut [u8]) -> usize {
    let end = near.now() + 10 * SECOND;
    loop {
        if let Some(length) = near.receive(buffer).expect("a frame or none") {
            return length;
        }
        assert!(near.now() < end, "no frame has come");
        near.wait(end);
    }
}

#[test]
fn frames_of_every_length_come_in_order_however_many_there_were_before() {
    if !inside_namespace(
        "frames::frames_of_every_length_come_in_order_however_many_there_were_before",
    ) {
        return;
    }
    let (mut near, far) = unprepared();
    let mut buffer = [0; 1514];
    let mut number = 0;
    for (place, burst) in [3, 30, 1, 100, 3, 256, 200, 256, 1, 77, 250, 256, 256]
        .into_iter()
        .enumerate()
    {
        if place == 2 {
            near.prepare().expect("a ring can be had");
        }
        let sent: Vec<_> = (0..burst)
            .map(|_| {
                number += 1;
                frame(number, 60 + number * 7 % 1455)
            })
            .collect();
        for frame in &sent {
            far.send(frame).unwrap();
        }
        for frame in &sent {
            let length = next(&mut near, &mut buffer);
            assert!(buffer[..length] == frame[..], "of {burst} at once");
        }
        assert_eq!(near.receive(&mut buffer).unwrap(), None);
    }
}

#[test]
fn a_frame_that_is_longer_than_the_buffer_is_passed_over() {
    if !inside_namespace("frames::a_frame_that_is_longer_than_the_buffer_is_passed_over") {
        return;
    }
    let (mut near, far) = unprepared();
    for _ in 0..2 {
        far.send(&frame(1, 200)).unwrap();
        far.send(&frame(2, 100)).unwrap();
        let mut buffer = [0; 100];
        assert_eq!(next(&mut near, &mut buffer), 100);
        assert!(buffer[..] == frame(2, 100)[..]);
        assert_eq!(near.receive(&mut buffer).unwrap(), None);
        near.prepare().expect("a ring can be had");
    }
}

#[test]
fn a_sleep_ends_with_a_frame_with_a_wake_and_at_its_time() {
    if !inside_namespace("frames::a_sleep_ends_with_a_frame_with_a_wake_and_at_its_time") {
        return;
    }
    let (mut near, far) = unprepared();
    sleeps(&mut near, &far);
    near.prepare().expect("a ring can be had");
    sleeps(&mut near, &far);
}

fn sleeps(near: &mut RawSocket, far: &Bare) {
    let far_off = near.now() + 10 * SECOND;
    near.waker().wake();
    near.wait(far_off);
    assert!(near.now() < far_off, "a wake ends it");
    far.send(&frame(1, 60)).unwrap();
    near.wait(far_off);
    assert!(near.now() < far_off, "a frame ends it");
    assert_eq!(near.receive(&mut [0; 1514]).unwrap(), Some(60));
    // Two come at once, and one of them is left.
    far.send(&frame(2, 60)).unwrap();
    far.send(&frame(3, 70)).unwrap();
    near.wait(far_off);
    assert_eq!(near.receive(&mut [0; 1514]).unwrap(), Some(60));
    near.wait(far_off);
    assert!(near.now() < far_off, "a frame that is there ends it");
    assert_eq!(near.receive(&mut [0; 1514]).unwrap(), Some(70));
    // The timer is set for a time that is far off.
    let soon = near.now() + Duration::from_millis(1);
    near.wait(soon);
    assert!(
        soon <= near.now() && near.now() < far_off,
        "its time ends it"
    );
    // And now it has rung.
    let again = near.now() + Duration::from_millis(1);
    near.wait(again);
    assert!(again <= near.now(), "no earlier time was named since");
    near.wait(soon);
    assert!(near.now() < far_off, "a time that is past already ends it");
}

#[test]
fn an_interface_that_goes_down_is_slept_over_and_received_from_when_it_is_up_again() {
    if !inside_namespace(
        "frames::an_interface_that_goes_down_is_slept_over_and_received_from_when_it_is_up_again",
    ) {
        return;
    }
    let (mut near, far) = ends();
    run("ip", &["link", "set", "master0", "down"]);
    let until = near.now() + Duration::from_millis(20);
    let mut sleeps = 0;
    while near.now() < until {
        near.wait(until);
        sleeps += 1;
    }
    assert!(sleeps <= 4, "{sleeps} sleeps instead of one");
    run("ip", &["link", "set", "master0", "up"]);
    // The cable has a signal some time after that.
    let end = near.now() + 10 * SECOND;
    let mut buffer = [0; 1514];
    while near.receive(&mut buffer).unwrap().is_none() {
        assert!(near.now() < end, "no frame has come");
        far.send(&frame(1, 60)).unwrap();
        near.wait(near.now() + Duration::from_millis(1));
    }
    assert!(buffer[..60] == frame(1, 60)[..]);
}

#[test]
fn the_first_frame_is_taken_when_the_interface_is_up_again() {
    if !inside_namespace("frames::the_first_frame_is_taken_when_the_interface_is_up_again") {
        return;
    }
    let (mut near, far) = ends();
    run("ip", &["link", "set", "master0", "down"]);
    near.wait(near.now() + SECOND / 50);
    run("ip", &["link", "set", "master0", "up"]);
    near.send(&frame(1, 60)).expect("the interface is up");
    drop(far);
}

#[test]
fn a_second_master_on_an_interface_is_refused_until_the_first_is_gone_whoever_it_is() {
    if !inside_namespace(
        "frames::a_second_master_on_an_interface_is_refused_until_the_first_is_gone_whoever_it_is",
    ) {
        return;
    }
    let is_in_use = || match RawSocket::open("master0") {
        Ok(_) => false,
        Err(RawSocketError::InUse(interface)) => {
            assert_eq!(interface, "master0");
            true
        }
        Err(error) => panic!("{error}"),
    };
    // The far end of the cable is another interface.
    let (mut near, far) = unprepared();
    assert!(is_in_use(), "by this program");
    near.prepare().expect("a ring can be had");
    assert!(is_in_use(), "by this program still");
    drop(near);
    assert!(!is_in_use());
    let stranger = Bare::open("master0").expect("it looks for nobody");
    assert!(is_in_use(), "by another master");
    drop(stranger);
    assert!(!is_in_use());
    drop(far);
}
