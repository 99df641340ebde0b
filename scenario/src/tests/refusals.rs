//! What every mistake is answered with.

use super::*;

#[test]
fn an_unknown_key_is_named_with_its_place_and_the_nearest_known_one() {
    assert_eq!(
        refused("[loop]\nrate = \"1kHz\"\n[plnat]\nmass = [1]"),
        "my.toml:3:2: unknown key `plnat.mass`, did you mean `plant.mass`?"
    );
    assert_eq!(
        refused("[controller.gains]\nbeta = 5\n  btea = 5"),
        "my.toml:3:3: unknown key `controller.gains.btea`, did you mean `controller.gains.beta`?"
    );
    assert_eq!(
        refused("[[fault]]\nkind = 'drop'\nat = 1\n[[fault]]\nkind = 'drop'\nprobabilty = 1"),
        "my.toml:6:1: unknown key `fault[1].probabilty`, did you mean `fault[].probability`?"
    );
    assert_eq!(refused("rate = 1"), "my.toml:1:1: unknown key `rate`, did you mean `loop.rate`?");
    assert_eq!(refused("[loop]\nxyzzy_plugh = 1"), "my.toml:2:1: unknown key `loop.xyzzy_plugh`");
}

#[test]
fn the_first_unknown_key_by_position_is_reported() {
    assert!(refused("[realtime]\nzzz = 1\n[loop]\naaa = 1").starts_with("my.toml:2:1: unknown key `realtime.zzz`"));
}

#[test]
fn values_out_of_their_limits_are_refused_with_key_found_and_allowed() {
    let cases = [
        (
            "[plant]\nmass = [1, 1]\nlength = [1, 1, 1]",
            "my.toml:3:1: `plant.length`: found 3 values, allowed: one number, or 2 (one a link)",
        ),
        ("[plant]\nmass = [1, -1, 1]", "my.toml:2:1: `plant.mass[1]`: found -1, allowed: a positive, finite number"),
        ("[plant]\nmass = 0", "my.toml:2:1: `plant.mass`: found 0, allowed: a positive, finite number"),
        ("[plant]\nmass = [1, nan, 1]", "`plant.mass[1]`: found NaN, allowed: a positive, finite number"),
        ("[plant]\nlength = inf", "`plant.length`: found inf, allowed: a positive, finite number"),
        ("[plant]\ngravity = nan", "`plant.gravity`: found NaN, allowed: a finite number"),
        ("[plant]\nlinks = 8", "`plant.links`: found 8 links, allowed: 1 to 7 links"),
        ("[plant]\nmass = []", "`plant`: found 0 links, allowed: 1 to 7 links"),
        ("[plant]\nmass_error = -1", "`plant.mass_error`: found -1, allowed: above -1"),
        ("[plant]\ntorque_limit_nm = nan", "`plant.torque_limit_nm`: found NaN"),
        ("[plant]\na = [[1]]", "`plant.b`: found nothing, allowed: b together with a"),
        ("[plant]\na = [[1, 2], [3, 4]]\nb = [1, 1]", "`plant.a[0][1]`: found 2, allowed: a symmetric matrix: a[1][0]"),
        (
            "[plant]\na = [[1, 2], [2, 1]]\nb = [1, 1]",
            "`plant.a`: found a matrix that is not, allowed: a positive definite matrix",
        ),
        ("[plant]\na = [[1]]\nb = [1]\nmass = [1]", "`plant.a`: found a beside link parameters"),
        ("[plant.noise]\nq_rad = -1", "`plant.noise.q_rad`: found -1"),
        (
            "[[plant.disturbance]]\nkind = 'sine'\namplitude_nm = 1",
            "`plant.disturbance[0].omega_rad_s`: found nothing, allowed: a value, which kind \"sine\" needs",
        ),
        (
            "[[plant.disturbance]]\nkind = 'constant'\nvalue_nm = 1\nrms_nm = 2",
            "`plant.disturbance[0].rms_nm`: found a value, allowed: none with kind \"constant\", whose keys are value_nm",
        ),
        ("[loop]\nrate = '60kHz'", "my.toml:2:1: `loop.rate`: found 60kHz, allowed: 1Hz to 50kHz"),
        ("[loop]\nrate = '0Hz'", "`loop.rate`: found 0Hz, allowed: 1Hz to 50kHz"),
        ("[loop]\nduration = '10us'", "`loop.duration`: found 10us, allowed: at least one period of 1ms"),
        (
            "[loop]\ngrace = '900us'",
            "`loop.grace`: found 900us, allowed: at most 750us, what the lead leaves of the period",
        ),
        (
            "[loop]\nlead = '600us'",
            "`loop.lead`: found 600us, allowed: at most 500us, what the grace leaves of the period",
        ),
        ("[loop]\ngrace = '0s'", "`loop.grace`: found 0s"),
        ("[loop]\nphase = '1ms'", "`loop.phase`: found 1ms, allowed: less than the period of 1ms"),
        ("[loop]\nmax_step = '0s'", "`loop.max_step`: found 0s, allowed: at least 1us, a thousandth of the period"),
        ("[controller.gains]\nbeta = 0", "`controller.gains.beta`: found 0"),
        ("[controller.uncertainty]\nmass = 1", "`controller.uncertainty.mass`: found 1, allowed: 0 to below 1"),
        ("[controller]\nstandby = 9", "`controller.standby`: found 9, allowed: 0 to 6"),
        ("[reference]\nkind = 'quintic'\nduration = '1s'", "`reference.to_rad`: found nothing"),
        ("[reference]\nradius_m = 1", "`reference.radius_m`: found a value, allowed: none with kind \"sine\""),
        ("[realtime]\npriority = 99", "`realtime.priority`: found 99"),
        ("[realtime]\ncores = [0, 99999]", "`realtime.cores[1]`: found 99999, allowed: 0 to 1023"),
        ("[realtime]\ncores = [1, 1]", "`realtime.cores[1]`: found 1, allowed: each core once"),
        ("[supervisor]\nplant = 'restart'", "`supervisor.plant`: found restart, allowed: end"),
        (
            "[swap_gate]\nrollback_misses = 101",
            "`swap_gate.rollback_misses`: found 101, allowed: 1 to rollback_window, 100",
        ),
        ("[[swap]]\nat = 1", "my.toml:1:1: `swap[0]`: found 0 of law, exe, to, allowed: exactly one of law, exe, to"),
        ("[[fault]]\nkind = 'kill'", "`fault[0].at`: found nothing, allowed: at, every or probability"),
        ("[[fault]]\nkind = 'drop'\nprobability = 1.5", "`fault[0].probability`: found 1.5, allowed: 0 to 1"),
        ("[[fault]]\nkind = 'drop'\nprobability = nan", "`fault[0].probability`: found NaN, allowed: 0 to 1"),
        ("[[fault]]\nkind = 'glitch'\nvalue_nm = 1\njoint = 4", "`fault[0].joint`: found 4, allowed: 1 to 3"),
        (
            "[[fault]]\nkind = 'glitch'\nvalue_nm = 1\ntarget = 'plant'",
            "`fault[0].target`: found plant, allowed: controller",
        ),
        ("[[fault]]\nkind = 'delay'\ndelay = '1ms'\ndistribution = 'uniform'", "`fault[0].delay_max`: found nothing"),
        ("[expect]\nconfidence = 1", "`expect.confidence`: found 1"),
    ];
    for (text, expected) in cases {
        let message = refused(text);
        assert!(message.contains(expected), "{text}\n  gave     {message}\n  expected {expected}");
        assert!(message.starts_with("my.toml:"), "no place: {message}");
    }
}

#[test]
fn wrong_types_units_and_words_are_refused_with_their_key() {
    let cases = [
        (
            "[loop]\nrate = 1000",
            "my.toml:2:1: `loop.rate`: found integer `1000`, allowed: text with a unit such as \"1kHz\"",
        ),
        ("[loop]\nrate = '20ms'", "`loop.rate`: found \"20ms\", allowed: a number with a unit such as \"1kHz\""),
        (
            "[loop]\nduration = '10 parsec'",
            "`loop.duration`: found \"10 parsec\", allowed: a number with a unit such as \"20ms\"",
        ),
        ("[loop]\nduration = '-1s'", "`loop.duration`: found \"-1s\", allowed: not negative"),
        ("[loop]\ngrace = '0.5ns'", "`loop.grace`: found \"0.5ns\", allowed: whole nanoseconds"),
        (
            "[loop]\nmode = 'lockstp'",
            "`loop.mode`: found \"lockstp\", allowed: realtime, lockstep, did you mean \"lockstep\"?",
        ),
        (
            "[controller]\nlaw = 'robst'",
            "`controller.law`: found \"robst\", allowed: robust, robust-ff, ctc, pd+g, did you mean \"robust\"?",
        ),
        ("[[swap]]\nat = '1s'\nlaw = 'pid'", "`swap[0].law`: found \"pid\", allowed: robust, robust-ff, ctc, pd+g"),
        ("[plant]\nmass = 'heavy'", "`plant.mass`: found string \"heavy\", allowed: a number, or a list"),
        ("[plant]\nmass = [1, 'x', 1]", "my.toml:2:1: `plant.mass[1]`: found string \"x\""),
        ("[controller]\nstandby = -1", "`controller.standby`: found integer `-1`"),
        ("loop = 3", "my.toml:1:1: `loop`: found integer `3`, allowed: a table"),
        ("[[swap]]\nlaw = 'ctc'", "my.toml:1:1: `swap[0].at`: is missing"),
        ("[[swap]]\nat = -1\nlaw = 'ctc'", "`swap[0].at`: found -1, allowed: not negative"),
        ("[[fault]]\nkind = 'drop'\ntarget = 'controller:0'", "`fault[0].target`: found \"controller:0\""),
        ("[[fault]]\nkind = 'explode'", "`fault[0].kind`: found \"explode\", allowed: kill, hang"),
        (
            "[expect]\n'round_trip.p99' = '50us'",
            "my.toml:2:1: `expect.round_trip.p99`: found \"50us\", allowed: a comparison",
        ),
        ("[expect]\nmissed_ticks = '<= many'", "my.toml:2:1: `expect.missed_ticks`: found \"<= many\""),
        ("[expect]\nmissed_ticks = '<= nan'", "`expect.missed_ticks`: found \"<= nan\""),
    ];
    for (text, expected) in cases {
        let message = refused(text);
        assert!(message.contains(expected), "{text}\n  gave     {message}\n  expected {expected}");
    }
}

#[test]
fn a_key_said_twice_and_broken_syntax_are_refused_with_their_place() {
    let twice = refused("[loop]\nrate = '1kHz'\nrate = '2kHz'");
    assert!(twice.starts_with("my.toml:3:1: ") && twice.contains("duplicate key"), "{twice}");
    let broken = refused("[loop\nrate = 1");
    assert!(broken.starts_with("my.toml:1:"), "{broken}");
}

#[test]
fn an_unreadable_file_is_named() {
    let error = Scenario::load(Path::new("/nonexistent/s.toml")).expect_err("there is no such file");
    assert!(error.to_string().starts_with("/nonexistent/s.toml: "), "{error}");
}

#[test]
fn bad_assignments_are_refused_with_what_was_written() {
    let cases = [
        ("loop.rate", "--set loop.rate: allowed: KEY=VALUE"),
        ("=3", "--set =3: the key is not a dotted key"),
        ("loop..rate=3", "the key is not a dotted key"),
        ("loop.rat=1kHz", "--set loop.rat=1kHz: unknown key `loop.rat`, did you mean `loop.rate`?"),
        ("loop.rate=fast", "--set loop.rate=fast: `loop.rate`: found \"fast\""),
        ("loop.rate=90kHz", "--set loop.rate=90kHz: `loop.rate`: found 90kHz"),
        ("plant.mass=[1, 0, 1]", "--set plant.mass=[1, 0, 1]: `plant.mass[1]`: found 0"),
        ("fault[3].kind=drop", "--set fault[3].kind=drop: the list has fewer entries"),
        ("loop=3", "--set loop=3: `loop`: found integer `3`, allowed: a table"),
    ];
    for (assignment, expected) in cases {
        let error = Scenario::default().with_set(assignment).expect_err("this must be refused").to_string();
        assert!(error.contains(expected), "{assignment}\n  gave     {error}\n  expected {expected}");
    }
}

#[test]
fn a_damaged_file_is_read_or_refused_in_one_line_but_never_breaks_the_program() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/faults.toml");
    let text = std::fs::read_to_string(file).expect("it can be read");
    let mut refusals = 0;
    for (at, removed) in text.char_indices() {
        for replacement in ["", "\u{e4}", "[", "\"", "\n", "-9"] {
            let damaged = format!("{}{replacement}{}", &text[..at], &text[at + removed.len_utf8()..]);
            if let Err(error) = Scenario::from_toml(&damaged, "my.toml") {
                let message = error.to_string();
                assert!(message.starts_with("my.toml:") && !message.contains('\n'), "{message}\n{damaged}");
                refusals += 1;
            }
        }
    }
    assert!(refusals > 1000, "{refusals} refusals");
}
