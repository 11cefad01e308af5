//! Frames and mails that are cut, that lie about their length or that are plain noise: never a panic, never a wrong effect.

use core::time::Duration;

use servocrab_sim::{Segment, personality};

use crate::master::{BRD, BWR, FPRD, FPWR, LRW, Master, frame};

fn preop() -> Master {
    let segment = Segment::new()
        .with(personality::akd2g())
        .with(personality::io_terminal())
        .with(personality::coupler());
    let mut master = Master::new(segment);
    master.bring_to_preop();
    master
}

/// A generator of noise (xorshift64), so that a failure can be repeated.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
}

#[test]
fn every_truncation_of_a_frame_executes_only_its_whole_datagrams() {
    let mut master = preop();
    let whole = frame(&[
        (BRD, 0, 0x0130, &[0; 2]),
        (FPRD, 0x1001, 0x0000, &[0; 16]),
        (LRW, 0, 0, &[0; 8]),
        (FPWR, 0x1001, 0x0120, &[2, 0]),
    ]);
    for length in 0..=whole.len() {
        let mut cut = whole[..length].to_vec();
        let processed = master.segment.process(&mut cut, Duration::ZERO);
        assert_eq!(processed, length >= 16, "length {length}");
        // The first datagram ends at byte 30; three devices answer it.
        if length >= 16 {
            assert_eq!(
                cut.get(28).copied().unwrap_or(0),
                if length >= 30 { 3 } else { 0 },
                "length {length}"
            );
        }
    }
}

#[test]
fn a_frame_of_another_ethertype_is_left_alone() {
    let mut master = preop();
    let mut bytes = frame(&[(BRD, 0, 0x0130, &[0; 2])]);
    bytes[12] = 0x08;
    let before = bytes.clone();
    assert!(!master.segment.process(&mut bytes, Duration::ZERO));
    assert_eq!(bytes, before);
}

#[test]
fn a_datagram_that_claims_more_than_the_frame_holds_is_not_executed() {
    let mut master = preop();
    let mut bytes = frame(&[(BWR, 0, 0x0120, &[1, 0])]);
    bytes[22] = 0xFF;
    assert!(master.segment.process(&mut bytes, Duration::ZERO));
    assert_eq!(master.al(0x1001), (2, 0));
}

#[test]
fn every_truncation_and_every_false_length_of_a_mail_is_survived() {
    let mails: [&[u8]; 5] = [
        &[0x00, 0x20, 0x40, 0x18, 0x10, 0x01, 0, 0, 0, 0],
        &[0x00, 0x20, 0x2F, 0x60, 0x60, 0x00, 1, 0, 0, 0],
        &[0x00, 0x20, 0x21, 0x00, 0x5F, 0x00, 20, 0, 0, 0, 1, 2, 3],
        &[0x00, 0x20, 0x00, 1, 2, 3, 4, 5, 6, 7],
        &[0x00, 0x20, 0x60, 0, 0, 0, 0, 0, 0, 0],
    ];
    let mut master = preop();
    for mail in mails {
        for length in 0..=mail.len() {
            master.post(3, &mail[..length]);
            let (_, reply) = master.fetch().expect("every mail is answered");
            let expected_error: &[u8] = &[1, 0, 6, 0];
            if length < 10 {
                assert_eq!(reply, expected_error, "length {length}");
            } else {
                assert!(reply.len() >= 10, "length {length}");
            }
        }
    }
    for claimed in [0u16, 1, 1018, 1019, 0xFFFF] {
        let mut mail = vec![0; 1024];
        mail[..2].copy_from_slice(&claimed.to_le_bytes());
        mail[5] = 0x03;
        master.write(0x1001, 0x1800, &mail);
        assert!(master.fetch().is_some(), "length field {claimed}");
    }
}

#[test]
fn noise_in_the_place_of_datagrams_is_survived() {
    let mut noise = Noise(0x1234_5678_9ABC_DEF1);
    for round in 0..300 {
        let mut master = preop();
        for _ in 0..40 {
            let mut bytes = frame(&[(BRD, 0, 0, &[0; 200])]);
            // Any command, address and length, with data behind it.
            for byte in bytes.iter_mut().skip(16) {
                *byte = noise.next() as u8;
            }
            bytes[16] %= 16;
            bytes[23] = 0;
            assert!(
                master
                    .segment
                    .process(&mut bytes, Duration::from_millis(round))
            );
        }
    }
}

#[test]
fn noise_in_the_registers_of_sync_managers_and_fmmus_is_survived() {
    let mut noise = Noise(0xFEED_0001);
    for _ in 0..200 {
        let mut master = preop();
        for area in [0x0600u16, 0x0800] {
            let bytes: Vec<u8> = (0..128).map(|_| noise.next() as u8).collect();
            master.exchange(BWR, 0, area, &bytes);
        }
        for address in [0x0FF0u16, 0x1000, 0x1800, 0x1C00, 0x2FF0, 0xFFF0] {
            master.exchange(BRD, 0, address, &[0; 64]);
            master.exchange(BWR, 0, address, &[0xA5; 64]);
        }
        let logical = noise.next();
        master.exchange(LRW, logical as u16, (logical >> 16) as u16, &[0; 64]);
        master.now += Duration::from_millis(3);
        assert_eq!(master.exchange(BRD, 0, 0x0130, &[0; 2]).1, 3);
    }
}
