//! What clients get of a running, simulated machine, over the socket.
#![allow(missing_docs)]

use std::{
    collections::BTreeMap,
    io::{ErrorKind, Read, Write},
    net::TcpStream,
    os::unix::{fs::PermissionsExt, net::UnixStream},
    path::Path,
    sync::{Arc, Mutex},
    time::Duration,
};

use serde_json::{Value, json};
use servocrab::{
    AxisConfig, DriveConfig, Network, Outcome, Referencing, SetPoint,
    bus::{RealTime, Scheduling},
    coe::{AxisOffset, obj},
    drives,
    ds402::State,
    link::Wire,
    units::{Mm, Ratio, Scale},
};
use servocrab_attach::{Attach, AttachError, Attached, serve};
use servocrab_sim::{Segment, personality};
use tempfile::TempDir;

fn machine() -> Network {
    machine_of(Arc::default())
}

/// An AKD2G is added to the line. 1000 counts are one millimetre on `x`; `y` is in counts.
fn machine_of(segment: Arc<Mutex<Segment>>) -> Network {
    segment.lock().unwrap().push(personality::akd2g());
    let wire = Wire::new(move |frame, now| segment.lock().unwrap().process(frame, now));
    let scale = Scale::counts_per_unit(Ratio::new(1000, 1).unwrap());
    let x = AxisConfig::new("x")
        .unit::<Mm>(scale)
        .referencing(Referencing::AbsoluteEncoder)
        .map_input(obj::FOLLOWING_ERROR_ACTUAL)
        .map_input(obj::TORQUE_ACTUAL);
    let drive = DriveConfig::new(drives::akd2g()).axis(x).axis("y");
    let builder = Network::builder()
        .link(wire)
        .cycle(Duration::from_millis(2));
    let builder = builder.drive(0, drive);
    smol::block_on(builder.start()).unwrap()
}

fn shown(net: &Network, attach: impl FnOnce(Attach) -> Attach) -> (TempDir, Attached) {
    let runtime = tempfile::tempdir().unwrap();
    let there = Attach::new("sim0").directory(runtime.path().join("servocrab"));
    let attached = serve(net, attach(there)).unwrap();
    (runtime, attached)
}

/// The status and the JSON of the answer.
fn ask(socket: &Path, request: &str) -> (u16, Value) {
    let (status, body) = answer(socket, request);
    (status, serde_json::from_str(&body).unwrap())
}

/// The status and the body of the answer.
fn answer(socket: &Path, request: &str) -> (u16, String) {
    let mut stream = UnixStream::connect(socket).unwrap();
    stream
        .set_read_timeout(Some(Duration::from_secs(10)))
        .unwrap();
    write!(
        stream,
        "{request} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    )
    .unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let status = answer[9..12].parse().unwrap();
    let (_, body) = answer.split_once("\r\n\r\n").unwrap();
    (status, body.to_owned())
}

/// The samples of `/metrics` by their names with labels. A line that is none of the format is a failure.
fn metrics(socket: &Path) -> BTreeMap<String, f64> {
    let (status, text) = answer(socket, "GET /metrics");
    assert_eq!(status, 200);
    let mut lines: Vec<_> = text.lines().collect();
    assert_eq!(lines.pop(), Some("# EOF"));
    let is_name = |name: &str| {
        name.starts_with("servocrab_")
            && name
                .bytes()
                .all(|byte| byte.is_ascii_lowercase() || byte == b'_')
    };
    let (mut samples, mut types) = (BTreeMap::new(), BTreeMap::new());
    for line in lines {
        if let Some(comment) = line.strip_prefix("# ") {
            let words: Vec<_> = comment.splitn(3, ' ').collect();
            assert!(is_name(words[1]), "{line}");
            match words[0] {
                "HELP" => assert!(words[2].ends_with('.'), "{line}"),
                "TYPE" => assert!(types.insert(words[1], words[2]).is_none(), "{line} again"),
                other => panic!("{other}: {line}"),
            }
            continue;
        }
        let (series, value) = line.rsplit_once(' ').unwrap();
        let (name, labels) = series.split_once('{').unwrap_or((series, "}"));
        assert!(is_name(name), "{line}");
        let labels = labels.strip_suffix('}').unwrap();
        for label in labels.split(',').filter(|label| !label.is_empty()) {
            let (key, value) = label.split_once("=\"").unwrap();
            assert!(key.bytes().all(|byte| byte.is_ascii_lowercase()), "{line}");
            let value = value.strip_suffix('"').unwrap();
            assert!(!value.contains(['"', '\\']), "{line}");
        }
        let declared = match name.strip_suffix("_total") {
            Some(name) => types.get(name) == Some(&"counter"),
            None => types.get(name) == Some(&"gauge"),
        };
        assert!(declared, "{line}: not declared before");
        let before = samples.insert(series.to_owned(), value.parse().unwrap());
        assert_eq!(before, None, "{line}: twice");
    }
    samples
}

#[test]
fn the_metrics_are_those_of_the_statistics_with_states_ports_and_emergencies() {
    let segment = Arc::default();
    let net = machine_of(Arc::clone(&segment));
    let (_runtime, attached) = shown(&net, |attach| attach);
    let socket = attached.socket();
    let fault = |segment: &Mutex<Segment>| {
        let mut segment = segment.lock().unwrap();
        segment.axis_mut(0, 1).unwrap().inject_fault(0x8611);
    };
    fault(&segment);
    let is_told = (0..500).any(|_| {
        std::thread::sleep(Duration::from_millis(10));
        let drive = &ask(socket, "GET /v1/statistics").1["drives"][0];
        drive["emergencies"] == json!([{"code": 0x8611, "number": 1}])
    });
    assert!(is_told);
    let running = metrics(socket);
    let has = |series: &str, value: f64| assert_eq!(running.get(series), Some(&value), "{series}");
    for (axis, state) in [("x", State::SwitchOnDisabled), ("y", State::Fault)] {
        has(
            &format!("servocrab_axis_state{{axis=\"{axis}\",state=\"{state}\"}}"),
            1.0,
        );
        has(&format!("servocrab_axis_lost{{axis=\"{axis}\"}}"), 0.0);
    }
    has(
        "servocrab_emergencies_total{drive=\"0\",code=\"8611h\"}",
        1.0,
    );
    // 603Fh is not among the objects that this drive maps by itself.
    has(
        "servocrab_axis_faults_total{axis=\"y\",code=\"other\"}",
        1.0,
    );
    let emergencies = ask(socket, "GET /v1/emergencies").1;
    assert_eq!(emergencies.as_array().unwrap().len(), 1, "{emergencies}");
    assert_eq!(
        (&emergencies[0]["code"], &emergencies[0]["text"]),
        (&0x8611.into(), &"following error".into())
    );
    let ports = running
        .keys()
        .filter(|series| series.starts_with("servocrab_port_errors_total{device=\"0\",port=\""));
    assert_eq!(ports.count(), 4 * 4);

    // Nothing counts any more; the ports cannot be asked either.
    smol::block_on(net.shutdown()).unwrap();
    let (ended, (_, statistics)) = (metrics(socket), ask(socket, "GET /v1/statistics"));
    assert!(!ended.keys().any(|series| series.contains("port_errors")));
    for name in [
        "cycles",
        "late_cycles",
        "overruns",
        "lost_frames",
        "late_frames",
        "damaged_frames",
        "frames_not_sent",
        "wrong_working_counters",
    ] {
        let sample = ended[&format!("servocrab_{name}_total")];
        assert_eq!(Some(sample), statistics[name].as_f64(), "{name}");
    }
    assert!(ended["servocrab_cycles_total"] > running["servocrab_cycles_total"]);
    for name in ["stale_cycles", "undelivered_cycles"] {
        let sample = ended[&format!("servocrab_{name}_total{{drive=\"0\"}}")];
        assert_eq!(Some(sample), statistics["drives"][0][name].as_f64());
    }
    for name in ["lateness", "round_trip"] {
        for (quantile, key) in [
            ("0", "least"),
            ("0.5", "50 %"),
            ("0.99", "99 %"),
            ("1", "most"),
        ] {
            let sample = ended[&format!("servocrab_{name}_seconds{{quantile=\"{quantile}\"}}")];
            let us = statistics[format!("{name}_us")][key].as_f64().unwrap();
            assert!(
                (sample * 1e6 - us).abs() < 1e-6,
                "{name} {key}: {sample} s, {us} µs"
            );
        }
    }
    assert_eq!(ended["servocrab_axis_lost{axis=\"x\"}"], 1.0);
}

#[test]
fn a_moving_axis_is_seen_in_its_unit_and_stopped_over_the_socket() {
    let net = machine();
    let (_runtime, attached) = shown(&net, |attach| attach);
    let socket = attached.socket();
    let x = net.axis_in::<Mm>("x").unwrap();
    smol::block_on(async {
        x.enable().await.unwrap();
        let mode = x.profile_position().await.unwrap();
        let slow = SetPoint::new()
            .velocity(20.0)
            .acceleration(1000.0)
            .deceleration(1000.0);
        let motion = mode.move_abs(1000.0, slow).await.unwrap();

        let (mut last, mut seen) = (f64::MIN, Vec::new());
        for _ in 0..3 {
            smol::Timer::after(Duration::from_millis(30)).await;
            let (status, axes) = ask(socket, "GET /v1/axes");
            assert_eq!(status, 200);
            let position = axes[0]["position"].as_f64().unwrap();
            assert!(position > last, "{position} after {last}");
            last = position;
            seen.push(axes);
        }
        let axes = seen.pop().unwrap();
        assert!(last > 0.2 && last < 100.0, "{last} mm");
        assert_eq!(axes[0]["name"], "x");
        assert_eq!(axes[0]["unit"], "mm");
        assert_eq!(axes[0]["state"], State::OperationEnabled.to_string());
        assert_eq!(axes[1]["state"], State::SwitchOnDisabled.to_string());
        assert!((axes[0]["velocity"].as_f64().unwrap() - 20.0).abs() < 2.0);
        // The plant lags behind its demand, and its motor pushes; `y` does not send these objects.
        let lag = axes[0]["following_error"].as_f64().unwrap();
        assert!(lag > 0.0 && lag < 5.0, "{lag} mm");
        let torque = axes[0]["torque"].as_f64().unwrap();
        assert!(torque.abs() < 3.0, "{torque} rated torques");
        assert_eq!(axes[1]["following_error"], Value::Null);

        let (status, _) = ask(socket, "POST /v1/axes/x/stop");
        assert_eq!(status, 202);
        let ended = motion.done().await;
        assert!(!matches!(ended, Ok(Outcome::Reached { .. })), "{ended:?}");
        assert!(x.status().position < 100.0, "stopped far from the target");
        let counted = ask(socket, "GET /v1/statistics").1;
        assert_eq!(counted["axes"][0]["motions"], json!({"stopped": 1}));
        net.shutdown().await.unwrap();
    });
}

#[test]
fn the_limits_are_what_the_drive_holds_now_for_each_of_its_axes() {
    let net = machine();
    let (_runtime, attached) = shown(&net, |attach| attach);
    let socket = attached.socket();
    smol::block_on(async {
        let sdo = net.sdo(0).unwrap();
        let of_y = AxisOffset::of_axis(2);
        for (object, value) in [
            (obj::SOFTWARE_LIMIT_MIN, -20_000),
            (obj::SOFTWARE_LIMIT_MAX, 500_000),
        ] {
            sdo.write(object, value).await.unwrap();
            sdo.write(object.offset(of_y), 2 * value).await.unwrap();
        }
        sdo.write(obj::MAX_PROFILE_VELOCITY, 250_000).await.unwrap();
        let (status, x) = ask(socket, "GET /v1/axes/x/limits");
        assert_eq!(status, 200, "{x}");
        assert_eq!(
            (&x["min_position"], &x["max_position"]),
            (&json!(-20.0), &json!(500.0))
        );
        assert_eq!(
            (&x["max_velocity"], &x["unit"]),
            (&json!(250.0), &json!("mm"))
        );
        let (_, y) = ask(socket, "GET /v1/axes/y/limits");
        assert_eq!(
            (&y["min_position"], &y["max_position"]),
            (&json!(-40_000.0), &json!(1_000_000.0))
        );
        sdo.write(obj::MAX_PROFILE_VELOCITY, u32::MAX)
            .await
            .unwrap();
        let (_, x) = ask(socket, "GET /v1/axes/x/limits");
        assert_eq!(x["max_velocity"], Value::Null);
        let (status, unknown) = ask(socket, "GET /v1/axes/z/limits");
        assert_eq!(
            (status, &unknown["error"]["code"]),
            (404, &json!("no_axis"))
        );
        net.shutdown().await.unwrap();
    });
}

#[test]
fn the_end_of_the_server_and_the_requests_for_reading_stop_no_axis() {
    let net = machine();
    let (_runtime, attached) = shown(&net, |attach| attach);
    let socket = attached.socket().to_owned();
    smol::block_on(async {
        let x = net.axis_in::<Mm>("x").unwrap();
        x.enable().await.unwrap();
        let mode = x.profile_position().await.unwrap();
        let there = SetPoint::new()
            .velocity(50.0)
            .acceleration(1000.0)
            .deceleration(1000.0);
        let motion = mode.move_abs(10.0, there).await.unwrap();
        ask(&socket, "GET /v1/axes");
        drop(attached);
        assert!(!socket.exists());
        let ended = motion.done().await;
        assert!(matches!(ended, Ok(Outcome::Reached { .. })), "{ended:?}");
        net.shutdown().await.unwrap();
    });
}

#[test]
fn a_quick_stop_needs_no_grant_and_stops_all_axes() {
    let net = machine();
    let (_runtime, attached) = shown(&net, |attach| attach);
    smol::block_on(async {
        let (x, y) = (net.axis("x").unwrap(), net.axis("y").unwrap());
        x.enable().await.unwrap();
        y.enable().await.unwrap();
        assert_eq!(ask(attached.socket(), "POST /v1/quick_stop").0, 202);
        for axis in [x, y] {
            while axis.status().state == State::OperationEnabled {
                axis.changed().await.unwrap();
            }
        }
        net.shutdown().await.unwrap();
    });
}

#[test]
fn the_line_the_statistics_and_objects_are_read_and_errors_are_json() {
    let net = machine();
    let (_runtime, attached) = shown(&net, |attach| attach);
    let socket = attached.socket();
    let mode = |path: &Path| path.metadata().unwrap().permissions().mode() & 0o777;
    assert_eq!(mode(socket), 0o600);
    assert_eq!(mode(socket.parent().unwrap()), 0o700);

    let (_, line) = ask(socket, "GET /v1/line");
    assert_eq!(line["drives"][0]["name"], "AKD2G");
    assert_eq!(line["drives"][0]["vendor"], 0x6A);
    let before = net.statistics().cycles;
    let (_, statistics) = ask(socket, "GET /v1/statistics");
    assert!((before..=net.statistics().cycles).contains(&statistics["cycles"].as_u64().unwrap()));
    assert!(statistics["lateness_us"]["most"].is_f64());
    // The vendor's number in little endian.
    let (status, vendor) = ask(socket, "GET /v1/od/0/1018h/1");
    assert_eq!((status, &vendor["bytes"]), (200, &json!([0x6A, 0, 0, 0])));

    for (request, status, code) in [
        ("GET /v1/od/0/5FFFh/0", 422, "aborted"),
        ("GET /v1/od/7/1018h/1", 404, "no_drive"),
        ("GET /v1/od/0/nothing/1", 400, "no_object"),
        ("POST /v1/axes/w/stop", 404, "no_axis"),
        ("GET /v1/quick_stop", 405, "wrong_method"),
        ("POST /v1/line", 405, "wrong_method"),
        ("POST /v1/od/0/6066h/0", 403, "not_granted"),
        ("GET /", 404, "no_such_request"),
    ] {
        let (got, answer) = ask(socket, request);
        assert_eq!(
            (got, &answer["error"]["code"]),
            (status, &code.into()),
            "{request}: {answer}"
        );
        assert!(!answer["error"]["text"].as_str().unwrap().is_empty());
    }
    smol::block_on(net.shutdown()).unwrap();
    let (status, answer) = ask(socket, "GET /v1/od/0/1018h/1");
    assert_eq!((status, &answer["error"]["code"]), (503, &"closed".into()));
    assert_eq!(ask(socket, "GET /v1/axes").1[0]["lost"], true);
}

#[test]
fn the_devices_and_the_signals_are_listed_and_a_wrong_name_is_refused_with_the_reason() {
    let net = machine();
    let (_runtime, attached) = shown(&net, |attach| attach);
    let socket = attached.socket();
    let (status, devices) = ask(socket, "GET /v1/devices");
    assert_eq!(status, 200, "{devices}");
    assert_eq!(devices.as_array().unwrap().len(), 1);
    let device = &devices[0];
    assert_eq!(
        (&device["kind"], &device["state"]),
        (&json!("drive"), &json!("OP"))
    );
    assert_eq!(device["ports"].as_array().unwrap().len(), 4);
    assert_eq!(device["ports"][0]["invalid_frames"], 0);
    let (_, signals) = ask(socket, "GET /v1/signals");
    let unit = |name: &str| {
        let mut signals = signals.as_array().unwrap().iter();
        signals
            .find(|known| known["signal"] == name)
            .map(|known| known["unit"].as_str().unwrap())
    };
    assert_eq!(unit("x.position"), Some("mm"));
    assert_eq!(unit("y.velocity"), Some("counts/s"));
    assert_eq!(unit("x.state"), Some(""));
    assert_eq!(unit("lateness"), Some("µs"));
    assert_eq!(unit("y.torque"), None, "it is not mapped");
    let (status, one) = ask(socket, "GET /v1/signals?name=6077h@0");
    assert_eq!((status, &one[0]["signal"]), (200, &json!("6077h:00@0")));
    for (name, reason) in [
        ("x.positon", "it has state, controlword"),
        ("z.position", "no axis is named `z`"),
        ("y.torque", "is not in the process data"),
        ("x", "is not understood"),
    ] {
        let (status, refused) = ask(socket, &format!("GET /v1/signals?name={name}"));
        let text = refused["error"]["text"].as_str().unwrap();
        assert!(status == 400 && text.contains(reason), "{name}: {text}");
    }
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn half_requests_are_closed_and_a_thousand_sockets_leave_room_for_others() {
    let net = machine();
    let patience = Duration::from_millis(500);
    let (_runtime, attached) = shown(&net, |attach| attach.clients(4).header_timeout(patience));
    let socket = attached.socket();
    for round in 0..250 {
        let four: Vec<_> = (0..4)
            .filter_map(|_| UnixStream::connect(socket).ok())
            .collect();
        for mut half in four {
            // A refused one is closed already.
            let _ = half.write_all(b"GET /v1/axes HTTP/1.1\r\nHo");
        }
        // Clients that have left take no place from the next one, however many there were.
        if round % 10 == 9 {
            assert_eq!(ask(socket, "GET /v1/axes").0, 200);
        }
    }
    let mut held: Vec<_> = (0..12)
        .map(|_| UnixStream::connect(socket).unwrap())
        .collect();
    let mut closed = 0;
    for half in &mut held {
        half.set_read_timeout(Some(Duration::from_secs(10)))
            .unwrap();
        let _ = half.write_all(b"GET /v1/axes HTTP/1.1\r\nHo");
        let mut rest = Vec::new();
        match half.read_to_end(&mut rest) {
            Ok(_) => closed += 1,
            Err(error) if error.kind() == ErrorKind::ConnectionReset => closed += 1,
            Err(error) => panic!("{error}: still open"),
        }
    }
    assert_eq!(
        closed, 12,
        "all were refused, or closed for their half request"
    );
    let large = format!("GET /v1/axes?{}", "a".repeat(100_000));
    let mut stream = UnixStream::connect(socket).unwrap();
    let _ = stream.write_all(format!("{large} HTTP/1.1\r\n").as_bytes());
    let mut answer = [0; 12];
    let read = stream.read(&mut answer).unwrap_or(0);
    assert_ne!(answer.get(9..read), Some(b"200".as_slice()));
    drop((stream, held));
    assert_eq!(ask(socket, "GET /v1/axes").0, 200);
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn more_clients_than_there_are_places_are_closed_until_one_leaves() {
    let net = machine();
    let patience = Duration::from_secs(60);
    let (_runtime, attached) = shown(&net, |attach| attach.clients(4).header_timeout(patience));
    let socket = attached.socket();
    let mut held: Vec<_> = (0..12)
        .map(|_| UnixStream::connect(socket).unwrap())
        .collect();
    for refused in held.split_off(4) {
        refused
            .set_read_timeout(Some(Duration::from_secs(10)))
            .unwrap();
        assert_eq!((&refused).read(&mut [0]).unwrap(), 0, "closed");
    }
    for kept in &held {
        kept.set_nonblocking(true).unwrap();
        let error = (&*kept).read(&mut [0]).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::WouldBlock, "open");
    }
    held.pop();
    let answered = (0..200).any(|_| {
        std::thread::sleep(Duration::from_millis(10));
        let mut stream = UnixStream::connect(socket).unwrap();
        let mut answer = [0; 12];
        let asked = stream.write_all(b"GET /v1/axes HTTP/1.1\r\nHost: localhost\r\n\r\n");
        asked.is_ok() && stream.read_exact(&mut answer).is_ok() && answer.ends_with(b"200")
    });
    assert!(answered);
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn who_fills_the_port_without_the_token_keeps_nobody_from_the_unix_socket() {
    let net = machine();
    let (_runtime, attached) = shown(&net, |attach| {
        let patience = Duration::from_secs(60);
        attach.clients(4).header_timeout(patience).loopback(0)
    });
    let panel = attached.panel().unwrap();
    let address = panel.strip_prefix("http://").unwrap();
    let address = address.split_once('/').unwrap().0;
    // None of them says anything, and four of them are kept.
    let held: Vec<_> = (0..12)
        .map(|_| TcpStream::connect(address).unwrap())
        .collect();
    for refused in &held[4..] {
        refused
            .set_read_timeout(Some(Duration::from_secs(10)))
            .unwrap();
        assert_eq!((&*refused).read(&mut [0]).unwrap(), 0, "closed");
    }
    assert_eq!(ask(attached.socket(), "POST /v1/axes/x/stop").0, 202);
    drop(held);
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn the_thread_of_the_server_is_ordinary_although_its_maker_is_real_time() {
    let net = machine();
    std::thread::scope(|scope| {
        let real_time = scope.spawn(|| {
            let asked = RealTime::new().scheduling(Scheduling::Fifo(7));
            if let Err(error) = asked.apply() {
                assert!(std::env::var_os("CI").is_none(), "{error}");
                eprintln!("skipped: {error}");
                return;
            }
            let (_runtime, attached) = shown(&net, |attach| attach);
            assert_eq!(ask(attached.socket(), "GET /v1/line").0, 200);
            let mut seen = 0;
            for thread in std::fs::read_dir("/proc/self/task").unwrap() {
                // Threads of other tests end meanwhile.
                let Ok(stat) = std::fs::read_to_string(thread.unwrap().path().join("stat")) else {
                    continue;
                };
                let (name, fields) = stat.rsplit_once(") ").unwrap();
                if name.ends_with("(servocrab-attac") {
                    seen += 1;
                    // Fields 40 and 41 of proc_pid_stat(5); the state is field 3.
                    let fields: Vec<_> = fields.split(' ').collect();
                    assert_eq!(&fields[37..39], ["0", "0"], "priority and class: {stat}");
                }
            }
            assert!(seen > 0);
        });
        real_time.join().unwrap();
    });
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn what_is_not_understood_is_refused_in_json_too() {
    let net = machine();
    let (_runtime, attached) = shown(&net, |attach| {
        attach.grant(servocrab_attach::Grant::Parameters)
    });
    let length = 70_000;
    let request = format!(
        "POST /v1/od/0/6081h/0 HTTP/1.1\r\nHost: localhost\r\nContent-Length: {length}\r\n\r\n"
    );
    let mut stream = UnixStream::connect(attached.socket()).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    // It may be refused before all of it was sent.
    let _ = stream.write_all(&vec![b'x'; length]);
    let mut answer = vec![0; 4096];
    let read = stream.read(&mut answer).unwrap();
    let answer = String::from_utf8_lossy(&answer[..read]);
    assert!(answer.starts_with("HTTP/1.1 413"), "{answer}");
    assert!(answer.contains("application/json"), "{answer}");
    drop(attached);
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn a_socket_in_use_an_open_directory_and_a_path_for_a_name_are_refused() {
    let net = machine();
    let (runtime, attached) = shown(&net, |attach| attach);
    let directory = runtime.path().join("servocrab");
    let again = || Attach::new("sim0").directory(&directory);
    assert!(matches!(serve(&net, again()), Err(AttachError::InUse(_))));
    let name = Attach::new("../sim0").directory(&directory);
    assert!(matches!(serve(&net, name), Err(AttachError::Name(_))));
    drop(attached);
    // A socket whose program was killed is replaced.
    drop(std::os::unix::net::UnixListener::bind(directory.join("sim0.sock")).unwrap());
    let attached = serve(&net, again()).unwrap();
    assert_eq!(ask(attached.socket(), "GET /v1/line").0, 200);
    drop(attached);
    // A file is not.
    let file = directory.join("sim0.sock");
    std::fs::write(&file, "kept").unwrap();
    let AttachError::Io { error, .. } = serve(&net, again()).unwrap_err() else {
        panic!("it is a file");
    };
    assert!(error.to_string().contains("no socket"), "{error}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "kept");
    std::fs::remove_file(&file).unwrap();
    // Nor is a link followed.
    let link = runtime.path().join("link");
    std::os::unix::fs::symlink(&directory, &link).unwrap();
    let by_link = Attach::new("sim0").directory(&link);
    assert!(matches!(
        serve(&net, by_link),
        Err(AttachError::Directory(_))
    ));
    let open = std::fs::Permissions::from_mode(0o777);
    std::fs::set_permissions(&directory, open).unwrap();
    assert!(matches!(
        serve(&net, again()),
        Err(AttachError::Directory(_))
    ));
    smol::block_on(net.shutdown()).unwrap();
}

/// A task of the program's waits for what clients ask for.
#[test]
fn what_is_shown_is_shared_by_tasks() {
    fn is_shared<T: Send + Sync>() {}
    is_shared::<servocrab_attach::Attached>();
    is_shared::<servocrab_attach::Forwarded>();
}
