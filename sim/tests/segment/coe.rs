//! SDO transfers, aborts, repeats and emergencies, byte by byte.

use core::time::Duration;

use servocrab_sim::{Segment, personality, personality::Servo};

use crate::master::{FPWR, Master, abort, request};

fn preop() -> Master {
    let mut master = Master::new(Segment::new().with(personality::akd2g()));
    master.bring_to_preop();
    master
}

#[test]
fn uploads_have_the_bytes_of_a_real_drive() {
    // A Kollmorgen AKD read by SOEM, public ethercrab repository, dumps/soem-sdinfo-akd.pcapng: number of sync managers,
    // first assigned PDO and first mapped object; only the number of assigned PDOs differs on the AKD2G.
    let exchanges: [(&[u8], &[u8]); 3] = [
        (
            &[0x00, 0x20, 0x40, 0x00, 0x1C, 0x00, 0, 0, 0, 0],
            &[0x00, 0x30, 0x4F, 0x00, 0x1C, 0x00, 4, 0, 0, 0],
        ),
        (
            &[0x00, 0x20, 0x40, 0x12, 0x1C, 0x01, 0, 0, 0, 0],
            &[0x00, 0x30, 0x4B, 0x12, 0x1C, 0x01, 0x00, 0x16, 0, 0],
        ),
        (
            &[0x00, 0x20, 0x40, 0x00, 0x16, 0x01, 0, 0, 0, 0],
            &[0x00, 0x30, 0x43, 0x00, 0x16, 0x01, 0x10, 0x00, 0x40, 0x60],
        ),
    ];
    let mut master = preop();
    for (sent, expected) in exchanges {
        assert_eq!(master.coe(sent), expected);
    }
}

#[test]
fn a_reply_carries_the_type_and_the_devices_own_counter() {
    let mut master = preop();
    for counter in [1, 2, 3] {
        master.post(3, &request(0x40, 0x1000, 0, &[]));
        assert_eq!(master.fetch().unwrap().0, counter << 4 | 3);
    }
}

#[test]
fn an_expedited_download_is_confirmed_and_read_back() {
    let mut master = preop();
    let reply = master.coe(&request(0x23, 0x6881, 0, &[0x10, 0x27, 0, 0]));
    assert_eq!(reply, [0x00, 0x30, 0x60, 0x81, 0x68, 0, 0, 0, 0, 0]);
    assert_eq!(master.upload(0x6881, 0), Ok(vec![0x10, 0x27, 0, 0]));
    assert_eq!(
        master.segment.axis(0, 1).unwrap().get(0x6081, 0),
        Some(10_000)
    );
    assert_ne!(
        master.segment.axis(0, 0).unwrap().get(0x6081, 0),
        Some(10_000)
    );
}

#[test]
fn a_normal_download_that_fits_one_message_needs_no_segment() {
    let mut master = preop();
    let mut data = 12u32.to_le_bytes().to_vec();
    data.extend(b"twelve bytes");
    assert_eq!(master.coe(&request(0x21, 0x5F00, 0, &data))[2], 0x60);
    assert_eq!(master.upload(0x5F00, 0), Ok(b"twelve bytes".to_vec()));
}

#[test]
fn a_text_goes_down_in_segments_with_alternating_toggle() {
    let mut master = preop();
    let mut first = 17u32.to_le_bytes().to_vec();
    first.extend(b"abc");
    assert_eq!(master.coe(&request(0x21, 0x5F00, 0, &first))[2], 0x60);
    assert_eq!(master.coe(b"\x00\x20\x00defghij")[..3], [0x00, 0x30, 0x20]);
    assert_eq!(master.coe(b"\x00\x20\x10klmnopq")[..3], [0x00, 0x30, 0x30]);
    assert_eq!(
        master.upload(0x5F00, 0),
        Ok(Vec::new()),
        "nothing is written before the last segment"
    );
    // That upload has ended the transfer; a segment now is out of place.
    assert_eq!(abort(&master.coe(b"\x00\x20\x01klmnopq")), 0x0504_0001);
    assert_eq!(master.coe(&request(0x21, 0x5F00, 0, &first))[2], 0x60);
    assert_eq!(master.coe(b"\x00\x20\x00defghij")[..3], [0x00, 0x30, 0x20]);
    assert_eq!(master.coe(b"\x00\x20\x11klmnopq")[..3], [0x00, 0x30, 0x30]);
    assert_eq!(master.upload(0x5F00, 0), Ok(b"abcdefghijklmnopq".to_vec()));
}

#[test]
fn a_download_segment_with_the_toggle_of_the_one_before_is_aborted() {
    let mut master = preop();
    master.coe(&request(0x21, 0x5F00, 0, &20u32.to_le_bytes()));
    master.coe(b"\x00\x20\x00defghij");
    assert_eq!(abort(&master.coe(b"\x00\x20\x00defghij")), 0x0503_0000);
}

#[test]
fn the_announced_size_must_be_kept() {
    let mut master = preop();
    master.coe(&request(0x21, 0x5F00, 0, &20u32.to_le_bytes()));
    // Seven bytes and "last": too few. Three of seven bytes unused (n = 3): still too few.
    assert_eq!(abort(&master.coe(b"\x00\x20\x01defghij")), 0x0607_0013);
    master.coe(&request(0x21, 0x5F00, 0, &3u32.to_le_bytes()));
    assert_eq!(abort(&master.coe(b"\x00\x20\x01defghij")), 0x0607_0012);
    master.coe(&request(0x21, 0x5F00, 0, &4u32.to_le_bytes()));
    assert_eq!(
        master.coe(b"\x00\x20\x07defg\x00\x00\x00")[..3],
        [0x00, 0x30, 0x20]
    );
    assert_eq!(
        abort(&master.coe(&request(0x21, 0x5F00, 0, &4097u32.to_le_bytes()))),
        0x0607_0012
    );
}

#[test]
fn a_long_text_comes_up_in_segments_of_a_short_mailbox() {
    use servocrab_sim::personality::Servo;
    // A mailbox of 32 bytes holds 16 bytes in the initiate reply and 23 in a segment.
    let mut master = Master::new(Segment::new().with(Servo::akd2g().mailbox_bytes(32).build()));
    master.mailbox = 32;
    master.bring_to_preop();
    let text: Vec<u8> = (0..60).collect();
    let mut first = 60u32.to_le_bytes().to_vec();
    first.extend(&text[..16]);
    assert_eq!(master.coe(&request(0x21, 0x5F00, 0, &first))[2], 0x60);
    for (command, piece) in [(0x00, &text[16..39]), (0x11, &text[39..60])] {
        let mut segment = vec![0x00, 0x20, command];
        segment.extend(piece);
        assert_eq!(master.coe(&segment)[2], 0x20 | command & 0x10);
    }
    let reply = master.coe(&request(0x40, 0x5F00, 0, &[]));
    assert_eq!(reply[..10], [0x00, 0x30, 0x41, 0x00, 0x5F, 0, 60, 0, 0, 0]);
    let mut read = reply[10..].to_vec();
    assert_eq!(read.len(), 16);
    for (command, answer) in [(0x60, 0x00), (0x70, 0x11)] {
        let reply = master.coe(&request(command, 0, 0, &[]));
        assert_eq!(reply[2], answer);
        read.extend(&reply[3..]);
    }
    assert_eq!(read, text);
    assert_eq!(abort(&master.coe(&request(0x60, 0, 0, &[]))), 0x0504_0001);
}

#[test]
fn a_main_device_that_gives_up_ends_the_transfer_without_an_answer() {
    let mut master = preop();
    master.coe(&request(0x21, 0x5F00, 0, &20u32.to_le_bytes()));
    master.coe(b"\x00\x20\x00abcdefg");
    // 0800 0000h, a general error.
    master.post(3, &request(0x80, 0x5F00, 0, &[0, 0, 0, 8]));
    assert_eq!(master.fetch(), None);
    assert_eq!(abort(&master.coe(b"\x00\x20\x10hijklmn")), 0x0504_0001);
    assert_eq!(master.upload(0x5F00, 0), Ok(Vec::new()));
}

#[test]
fn an_upload_segment_asked_for_twice_is_aborted_with_the_objects_address() {
    let mut master = Master::new(Segment::new().with(Servo::akd2g().mailbox_bytes(32).build()));
    master.mailbox = 32;
    master.bring_to_preop();
    // The name has 26 bytes: 16 in the first mail, the rest in a segment of which toggle 1 is wrong.
    let first = master.coe(&request(0x40, 0x1008, 0, &[]));
    assert_eq!(first[..10], [0x00, 0x30, 0x41, 0x08, 0x10, 0, 26, 0, 0, 0]);
    let reply = master.coe(&request(0x70, 0, 0, &[]));
    assert_eq!(
        reply,
        [0x00, 0x20, 0x80, 0x08, 0x10, 0x00, 0x00, 0x00, 0x03, 0x05]
    );
    // The transfer is over, and a new one begins with toggle 0.
    assert_eq!(abort(&master.coe(&request(0x60, 0, 0, &[]))), 0x0504_0001);
    master.coe(&request(0x40, 0x1008, 0, &[]));
    let last = master.coe(&request(0x60, 0, 0, &[]));
    assert_eq!(last, b"\x00\x30\x01rive (CoE)");
}

#[test]
fn a_last_segment_of_less_than_seven_bytes_says_how_many_are_unused() {
    let mut master = Master::new(Segment::new().with(Servo::akd2g().mailbox_bytes(32).build()));
    master.mailbox = 32;
    master.bring_to_preop();
    let mut text = 18u32.to_le_bytes().to_vec();
    text.extend(b"sixteen bytes of");
    master.coe(&request(0x21, 0x5F00, 0, &text));
    master.coe(b"\x00\x20\x0Bit\x00\x00\x00\x00\x00");
    let first = master.coe(&request(0x40, 0x5F00, 0, &[]));
    assert_eq!(first[6..], text);
    // Two of seven bytes used: n = 5, last: 0Bh; the mail is not shorter than ten bytes.
    let last = master.coe(&request(0x60, 0, 0, &[]));
    assert_eq!(last, b"\x00\x30\x0Bit\x00\x00\x00\x00\x00");
}

#[test]
fn a_long_text_fills_many_messages_both_ways() {
    let mut master = preop();
    let text: Vec<u8> = (0..4096u32).map(|at| (at % 251) as u8).collect();
    // A mailbox of 1024 bytes: 1008 in the first mail, 1015 in each segment.
    let mut data = 4096u32.to_le_bytes().to_vec();
    data.extend(&text[..1008]);
    assert_eq!(master.coe(&request(0x21, 0x5F00, 0, &data))[2], 0x60);
    let pieces: Vec<&[u8]> = text[1008..].chunks(1015).collect();
    for (at, piece) in pieces.iter().enumerate() {
        let toggle = (at as u8 % 2) << 4;
        let mut segment = vec![0x00, 0x20, toggle | u8::from(at + 1 == pieces.len())];
        segment.extend(*piece);
        segment.resize(segment.len().max(10), 0);
        assert_eq!(master.coe(&segment)[..3], [0x00, 0x30, 0x20 | toggle]);
    }
    let first = master.coe(&request(0x40, 0x5F00, 0, &[]));
    assert_eq!(first[2], 0x41);
    let mut read = first[10..].to_vec();
    for toggle in [0, 0x10].into_iter().cycle() {
        let reply = master.coe(&request(0x60 | toggle, 0, 0, &[]));
        assert_eq!(reply[2] & 0xFE, toggle);
        read.extend(&reply[3..]);
        if reply[2] & 1 != 0 {
            break;
        }
    }
    assert!(read == text);
}

#[test]
fn each_refusal_has_its_abort_code() {
    let mut master = preop();
    assert_eq!(master.upload(0x2345, 0), Err(0x0602_0000));
    assert_eq!(master.upload(0x6FFF, 0), Err(0x0602_0000));
    assert_eq!(master.upload(0x1018, 5), Err(0x0609_0011));
    assert_eq!(master.upload(0x6041, 1), Err(0x0609_0011));
    assert_eq!(master.download(0x6041, 0, &[0, 0]), Err(0x0601_0002));
    assert_eq!(master.download(0x1018, 1, &[0; 4]), Err(0x0601_0002));
    assert_eq!(master.download(0x5000, 4, &[0; 4]), Err(0x0601_0002));
    assert_eq!(master.download(0x6081, 0, &[0; 2]), Err(0x0607_0013));
    assert_eq!(master.download(0x6040, 0, &[0; 4]), Err(0x0607_0012));
    assert_eq!(master.upload(0x5F01, 2), Err(0x0601_0001));
    assert_eq!(master.upload(0x1003, 1), Err(0x0800_0024));
    assert_eq!(master.download(0x605A, 0, &[99, 0]), Err(0x0609_0030));
    assert_eq!(
        abort(&master.coe(&request(0x50, 0x1018, 0, &[]))),
        0x0601_0004
    );
    assert_eq!(
        abort(&master.coe(&request(0xE0, 0x1018, 0, &[]))),
        0x0504_0001
    );
    assert_eq!(abort(&master.coe(&request(0x60, 0, 0, &[]))), 0x0504_0001);
}

#[test]
fn the_communication_objects_tell_what_the_drive_is() {
    let mut master = preop();
    assert_eq!(master.upload(0x1000, 0), Ok(vec![0x92, 0x01, 0x02, 0x00]));
    assert_eq!(master.upload(0x1001, 0), Ok(vec![0]));
    assert_eq!(
        master.upload(0x1008, 0),
        Ok(b"AKD2G EtherCAT Drive (CoE)".to_vec())
    );
    assert_eq!(master.upload(0x1018, 2), Ok(vec![0x32, 0x44, 0x4B, 0x41]));
    assert_eq!(master.upload(0x5000, 0), Ok(vec![4]));
    // The second axis is in its position window: bit 15.
    assert_eq!(master.upload(0x5100, 4), Ok(vec![0, 0x80, 0, 0]));
    assert_eq!(master.upload(0x6000, 0), Err(0x0602_0000));
}

#[test]
fn messages_of_other_protocols_are_answered_with_a_mailbox_error() {
    let mut master = preop();
    // Servo over EtherCAT, which the AKD2G's SII does not have.
    master.post(5, &[0; 10]);
    assert_eq!(master.fetch(), Some((0x10, vec![1, 0, 2, 0])));
    // SDO information is not supported, as on the AKD: the abort 05040001h, unknown command.
    master.post(3, &[0x00, 0x80, 1, 0, 0, 0, 1, 0]);
    let abort = vec![0x00, 0x20, 0x80, 0, 0, 0, 0x01, 0x00, 0x04, 0x05];
    assert_eq!(master.fetch(), Some((0x23, abort)));
    master.post(3, &[0x00]);
    assert_eq!(master.fetch(), Some((0x30, vec![1, 0, 6, 0])));
}

#[test]
fn a_full_mailbox_refuses_the_write_and_an_empty_one_the_read() {
    let mut master = preop();
    let device = master.segment.device_mut(0).unwrap();
    device.set_mailbox_delay(Duration::from_millis(5));
    assert_eq!(master.fetch(), None);
    master.post(3, &request(0x40, 0x1000, 0, &[]));
    // The first request is being worked on, the second one fills the mailbox.
    master.post(3, &request(0x40, 0x1000, 0, &[]));
    assert_eq!(master.exchange(5, 0x1001, 0x1800, &[0; 1024]).1, 0);
    assert_eq!(master.read::<1>(0x1001, 0x0805), [0x08]);
    assert_eq!(master.read::<1>(0x1001, 0x080D), [0x00]);
    master.now += Duration::from_millis(6);
    assert_eq!(master.read::<1>(0x1001, 0x080D), [0x08]);
    assert!(master.fetch().is_some());
}

#[test]
fn requests_that_nobody_reads_the_answers_of_stay_in_the_mailbox() {
    let mut master = preop();
    let mut mail = vec![10, 0, 0, 0, 0, 0];
    mail.extend(request(0x40, 0x1000, 0, &[]));
    mail.resize(1024, 0);
    let mut taken = 0;
    for counter in (1..=7).cycle().take(100) {
        mail[5] = counter << 4 | 3;
        taken += master.exchange(FPWR, 0x1001, 0x1800, &mail).1;
    }
    assert!((32..=40).contains(&taken), "{taken}");
    let answers = core::iter::from_fn(|| master.fetch()).count();
    assert_eq!(answers, usize::from(taken), "none is lost");
}

#[test]
fn an_error_message_of_the_main_device_is_not_answered() {
    let mut master = preop();
    master.post(0, &[1, 0, 1, 0]);
    assert_eq!(master.fetch(), None);
    assert!(master.upload(0x1000, 0).is_ok());
}

#[test]
fn a_lost_reply_is_repeated_on_request() {
    let mut master = preop();
    let reply = master.coe(&request(0x40, 0x1018, 1, &[]));
    master.write(0x1001, 0x080E, &[0x03]);
    assert_eq!(master.read::<2>(0x1001, 0x080E), [0x03, 0x02]);
    assert_eq!(master.fetch().unwrap().1, reply);
    assert_eq!(master.fetch(), None);
}

#[test]
fn an_injected_emergency_is_the_next_message() {
    let mut master = preop();
    let device = master.segment.device_mut(0).unwrap();
    device.inject_emergency(0x7320, 0x21, [1, 2, 3, 4, 5], Duration::ZERO);
    master.post(3, &request(0x40, 0x1000, 0, &[]));
    assert_eq!(
        master.fetch().unwrap().1,
        [0x00, 0x10, 0x20, 0x73, 0x21, 1, 2, 3, 4, 5]
    );
    assert_eq!(master.fetch().unwrap().1[..3], [0x00, 0x30, 0x43]);
}

#[test]
fn errors_are_remembered_until_they_are_cleared() {
    let mut master = preop();
    assert_eq!(master.upload(0x1003, 0), Ok(vec![0]));
    for code in [0x7320, 0x0000, 0x8611] {
        let device = master.segment.device_mut(0).unwrap();
        device.inject_emergency(code, 0x21, [0; 5], Duration::ZERO);
        assert!(master.fetch().is_some());
    }
    assert_eq!(master.upload(0x1003, 0), Ok(vec![2]));
    assert_eq!(master.upload(0x1003, 1), Ok(vec![0x11, 0x86, 0, 0]));
    assert_eq!(master.upload(0x1003, 2), Ok(vec![0x20, 0x73, 0, 0]));
    assert_eq!(master.download(0x1003, 0, &[0]), Ok(()));
    assert_eq!(master.upload(0x1003, 0), Ok(vec![0]));
}

#[test]
fn an_emergency_that_comes_late_overtakes_the_replies_that_still_wait() {
    let mut master = preop();
    master.post(3, &request(0x40, 0x1000, 0, &[]));
    master.post(3, &request(0x40, 0x1001, 0, &[]));
    let device = master.segment.device_mut(0).unwrap();
    device.inject_emergency(0x7320, 0x21, [0; 5], Duration::ZERO);
    assert_eq!(device.queued_messages(), 2);
    let services: Vec<u8> = core::iter::from_fn(|| master.fetch())
        .map(|(_, mail)| mail[1] >> 4)
        .collect();
    assert_eq!(services, [3, 1, 3]);
}
