//! What is refused, and what is named: the place, the key, the number, and what would be right.

use super::*;

#[test]
fn unknown_names_come_with_the_nearest_and_their_place() {
    refused_with(
        "[grid]\n\n  ptich = [1, 1, 1]",
        &["run.toml:3:3", "`grid.ptich`", "`ptich`", "[grid]", "`pitch`", "x, y"],
    );
    refused_with("[swep]\nstep = 1", &["run.toml:1:2", "[swep]", "[sweep]", "medium"]);
    refused_with("[[material]]\nname = 'a'", &["[material]", "[materials]"]);
    refused_with("step = 20", &["run.toml:1:1", "`step`", "[sweep]"]);
    refused_with("[sweep]\nmedian = 3", &["`median`", "[sweep]", "[depth]"]);
    refused_with("[array]\ncenter = [0,0,0]", &["`center`", "`centre`"]);
    refused_with(
        "[depth]\npick = \"strongst\"",
        &["`depth.pick`", "\"strongst\"", "\"strongest\", \"first\""],
    );
    refused_with("[expect]\ncompletness = { min = 0.5 }", &["`completness`", "`completeness`"]);
    refused_with("[expect]\nrmse = { mx = 0.5 }", &["`expect.rmse.mx`", "`max`"]);
    refused_with(
        "[[materials]]\nname = 'a'\n[[materials]]\nname = 'b'\nreflectence = 1",
        &["run.toml:5:1", "`materials[1].reflectence`", "`reflectance`"],
    );
}

#[test]
fn views_and_limits_that_mean_nothing_are_refused() {
    refused_with("[depth]\nfov = 50.0", &["run.toml:2:1", "depth.fov", "view = \"perspective\""]);
    refused_with("[depth]\npixels = [64, 48]", &["depth.pixels", "view = \"perspective\""]);
    let camera = |key: &str| format!("[depth]\nview = \"perspective\"\n{key}");
    refused_with(&camera("fov = 180.0"), &["run.toml:3:1", "`depth.fov`", "0", "180"]);
    refused_with(&camera("pixels = [64, 0]"), &["depth.pixels", "1"]);
    refused_with("[depth]\nreturn_contrast_db = -3.0", &["depth.return_contrast_db", "60 dB"]);
    refused_with("[expect]\nseeds = [1, 2, 1]", &["expect.seeds", "1"]);
    refused_with("[expect]\nseeds = 3", &["expect.seeds", "list"]);
    refused_with(
        "[expect]\n\"completness:glass\" = { min = 0.5 }",
        &["`completness`", "`completeness`", "NAME:MATERIAL"],
    );
    refused_with("[expect]\n\"completeness#0\" = { min = 0.5 }", &["`completeness#0`"]);
    refused_with("[expect]\n\"two_returns:glass\" = { min = 90 }", &["two_returns:glass", "90", "0 to 1"]);
}

#[test]
fn what_this_version_lacks_is_refused_with_what_it_has() {
    refused_with(
        "[reconstruct]\nmethod = \"holographic\"",
        &[
            "holographic",
            "\"auto\", \"convolution\", \"backprojection\", \"direct\", \"linear\", \"correlation\"",
        ],
    );
    refused_with("[array]\nlayout = \"ring\"", &["ring", "\"grid\", \"spiral\", \"random\", \"file\""]);
    refused_with("[depth]\nview = \"isometric\"", &["isometric", "\"orthographic\", \"perspective\""]);
    refused_with(
        "[output]\nformats = [\"exr\", \"hdf5\"]",
        &["formats[1]", "hdf5", "\"exr\", \"npz\", \"zarr\", \"vti\", \"nrrd\", \"vdb\""],
    );
    refused_with(
        "[output]\nvdb_threshold_db = 3.0",
        &["`output.vdb_threshold_db`", "3.0", "0 dB or less, such as -40.0"],
    );
}

#[test]
fn wrong_types_are_named_in_plain_words() {
    refused_with("[sweep]\nstep = \"20\"", &["2:1", "`sweep.step`", "\"20\"", "quotes"]);
    refused_with(
        "[scene]\nsize = \"0.3m\"",
        &["2:1", "`scene.size`", "\"0.3m\"", "without its unit", "in m"],
    );
    refused_with(
        "[sweep]\nstart = \"10 kHz\"",
        &["`sweep.start`", "\"10 kHz\"", "without its unit", "in Hz"],
    );
    assert!(!refused("[sweep]\nstart = \"low\"").contains("unit"));
    refused_with("[sweep]\nstep = true", &["`sweep.step`", "true", "number"]);
    refused_with("[sweep]\nstep = nan", &["`sweep.step`", "NaN", "finite"]);
    refused_with("[grid]\npitch = 0.01", &["`grid.pitch`", "list of 3", "[0.01, 0.01, 0.01]"]);
    refused_with("[grid]\npitch = -1", &["`grid.pitch`", "found the number -1", "such as [1, 1, 1]"]);
    refused_with(
        "[grid]\nx = [0, 1]\npitch = [-0.01, 0.02]",
        &["`grid.pitch`", "such as [0.01, 0.02, 0.02]"],
    );
    refused_with("[grid]\npitch = \"fine\"", &["`grid.pitch`", "list of 3", "[0.01, 0.01, 0.01]"]);
    refused_with("[grid]\npitch = 0", &["`grid.pitch`", "found the number 0", "such as [0.01, 0.01, 0.01]"]);
    refused_with("[array]\nsource = \"here\"", &["`array.source`", "list of 3", "[0.0, 0.0, 0.0]"]);
    refused_with(
        "[grid]\npitch = [0.01, 0.02]",
        &["`grid.pitch`", "list of 2", "list of 3", "[0.01, 0.02, 0.02]"],
    );
    refused_with("[grid]\npitch = [1, 2, 3, 4]", &["`grid.pitch`", "list of 4", "list of 3", "[1, 2, 3]"]);
    refused_with("[grid]\npitch = [0.01,\n 0.01,\n \"a\"]", &["run.toml:4:2", "`grid.pitch[2]`"]);
    refused_with("[grid]\nx = [0, 1, 2]", &["`grid.x`", "length 3", "[first, last]"]);
    refused_with("[grid]\nx = \"a\"", &["`grid.x`", "\"a\"", "[first, last]"]);
    refused_with("[array]\ncount = [3.5, 4]", &["`array.count", "3.5", "whole number"]);
    refused_with("[array]\ncount = [-3, 4]", &["`array.count", "-3", "whole number", "0"]);
    refused_with("[scene]\nmesh = 3", &["`scene.mesh`", "3", "quotes"]);
    refused_with("[scene]\nunit = 3", &["`scene.unit`", "\"m\", \"cm\", \"mm\", \"in\", \"ft\""]);
    refused_with("scene = 3", &["run.toml:1:1", "`scene`", "table", "mesh, unit"]);
    refused_with("[materials]\nname = \"a\"", &["`materials`", "[[materials]]"]);
    refused_with("[[materials]]\nreflectance = 1", &["`name`", "missing"]);
    refused_with("[expect]\nrmse = 0.5", &["`expect.rmse`", "0.5", "table", "min, max"]);
    refused_with("[depth]\nfill = \"zero\"", &["`depth.fill`", "\"zero\"", "\"inf\", \"nan\"", "number"]);
    refused_with("[sweep]\nstep = 1979-05-27", &["`sweep.step`", "date"]);
}

#[test]
fn values_outside_their_range_are_refused_at_their_line() {
    for (text, parts) in [
        ("[sweep]\nstart = 10\nstop = 20\nstep = 0", &["4:1", "`sweep.step`", "0"][..]),
        ("[sweep]\nstart = 30000", &["run.toml:1:2", "`sweep.stop`", "20000", "30000"]),
        (
            "[sweep]\nstep = 30",
            &["`sweep.step`", "333.3333", "30", "stop = 19990", "step = 30.03003003003003"],
        ),
        ("[sweep]\nstep = 30000", &["`sweep.step`", "step = 10000.0"]),
        ("[sweep]\nstep = 1e-9", &["`sweep.step`", "many"]),
        ("[[materials]]\nname = 'a'\nreflectance = 1.5", &["`materials[0].reflectance`", "1.5", "0 to 1"]),
        ("[[materials]]\nname = 'a'\ntransmittance = -1", &["`materials[0].transmittance`", "-1", "0 to 1"]),
        ("[[materials]]\nname = ''", &["name", "\"*\""]),
        ("[grid]\nz = [-1, 1]", &["`grid.z`", "-1", "array"]),
        ("[grid]\nx = [1, -1]", &["`grid.x`", "-1", "1"]),
        ("[grid]\npitch = [0, 1, 1]", &["`grid.pitch", "0"]),
        ("[grid]\nx = [0, 1e300]\npitch = [1e-9, 1, 1]", &["`grid.x`", "many"]),
        ("[medium]\nsound_speed = -343", &["`medium.sound_speed`", "-343", "0.01"]),
        ("[medium]\ntemperature = 500", &["`medium.temperature`", "500", "-50", "60"]),
        ("[medium]\ntemperature = 20\nhumidity = 101", &["`medium.humidity`", "101", "0", "100"]),
        ("[medium]\ntemperature = 20\npressure = 101", &["`medium.pressure`", "101", "1e4", "1e6 Pa"]),
        ("[medium]\ntemperature = 60\nhumidity = 100\npressure = 2e4", &["medium", "water"]),
        ("[medium]\nhumidity = 40", &["`medium.humidity`", "`temperature`"]),
        ("[medium]\nabsorption = true", &["`medium.absorption`", "`temperature`"]),
        ("[medium]\nsound_speed = 340\ntemperature = 20", &["`medium.temperature`", "speed"]),
        ("[array]\nspeaker_radius = -1", &["`array.speaker_radius`", "-1", "0"]),
        ("[array]\nphase_error = 400", &["`array.phase_error`", "400", "0", "360"]),
        ("[reflectors]\nspacing = 0", &["`reflectors.spacing`", "0"]),
        ("[reflectors]\nroughness = -1", &["`reflectors.roughness`", "-1", "0"]),
        ("[depth]\nreturns = 0", &["`depth.returns`", "0", "1", "16"]),
        ("[depth]\nreturns = 17", &["`depth.returns`", "17", "1", "16"]),
        ("[depth]\nmedian = 4", &["`depth.median`", "4", "odd"]),
        ("[depth]\nmedian = 0", &["`depth.median`", "0", "odd"]),
        ("[depth]\nseparation = 0", &["`depth.separation`", "0"]),
        ("[depth]\nsmoothing = [0, -1, 0]", &["`depth.smoothing", "-1", "0"]),
        ("[depth]\nthreshold_db = 14", &["`depth.threshold_db`", "14", "0"]),
        ("[depth]\nfill = -inf", &["`depth.fill`", "-inf"]),
        ("[reconstruct]\ntolerance = 1", &["`reconstruct.tolerance`", "1"]),
        ("[detection]\ntolerance = -1e-6", &["`detection.tolerance`", "-1e-6"]),
        ("[detection]\ntolerance = 5e-324", &["`detection.tolerance`", "1e-9"]),
        ("[reconstruct]\ntolerance = 5e-324", &["`reconstruct.tolerance`", "1e-9", "0 for the exact sum"]),
        ("[detection]\nsnr_db = -1e300", &["`detection.snr_db`", "-200"]),
        ("[medium]\nsound_speed = 1e-9", &["`medium.sound_speed`", "1e-9", "0.01"]),
        ("[medium]\nsound_speed = 5e-324", &["`medium.sound_speed`", "0.01"]),
        ("[array]\nsource = [0, 1e15, 0]", &["`array.source`", "1000000000000000", "1e9 m"]),
        ("[reflectors]\nroughness = 1e300", &["`reflectors.roughness`", "1e6"]),
        ("[array]\ncount = [0, 1]", &["`array.count", "1"]),
        ("[array]\ncount = [4000000000, 4000000000]", &["`array.count`", "many"]),
        ("[array]\ncount = [1, 1]\nextent = [1, 0]", &["`array.extent`", "one microphone along x"]),
        ("[array]\ngeometry = \"monostatic\"\nsource = [0, 0, 1]", &["`array.source`", "speaker"]),
        ("[array]\nlayout = \"file\"", &["`array.layout`", "`file`"]),
        ("[array]\nfile = \"a.csv\"", &["`array.file`", "`layout = \"file\"`"]),
        ("[array]\nlayout = \"file\"\nfile = \"a.csv\"\ncount = [2, 2]", &["4:1", "`array.count`", "file"]),
        ("[array]\nelements = 200", &["`array.elements`", "200", "196"]),
        ("[array]\nelements = 0", &["`array.elements`", "1"]),
        ("[array]\nelements = 256\ncount = [16, 16]", &["`array.elements`", "count"]),
        ("[array]\nlayout = \"spiral\"\nseed = 2", &["3:1", "`array.seed`", "`layout = \"random\"`"]),
        ("[array]\nspacing = 0.01", &["2:1", "`array.spacing`", "`layout = \"random\"`"]),
        ("[array]\nlayout = \"random\"\nspacing = -1", &["`array.spacing`", "-1", "0"]),
        ("[array]\nlayout = \"random\"\nfile = \"a.csv\"", &["`array.file`", "`layout = \"file\"`"]),
        ("[array]\nextent = [1, 1, 1]", &["`array.extent`", "[along x, along y]"]),
        ("[array]\ncount = 3.5", &["`array.count`", "3.5"]),
        ("[array]\npitch = [1, 1]\nextent = [1, 1]", &["3:1", "`array.extent`", "pitch"]),
        ("[scene]\nfit = [0, 0, 1]\ntranslate = [0, 0, 1]", &["2:1", "`scene.fit`", "translate"]),
        ("[scene]\nfit = [0, 0, 1]\nsensor = \"node:a\"", &["`scene.fit`", "sensor"]),
        ("[scene]\nsensor = \"Front\"", &["`scene.sensor`", "Front", "camera:NAME"]),
        ("[scene]\nsensor = \"camera:\"", &["`scene.sensor`", "camera:NAME"]),
        ("[scene]\nscale = 0", &["`scene.scale`", "0"]),
        ("[scene]\nmesh = \"\"", &["`scene.mesh`", "empty"]),
        ("[[scene.parts]]\nunit = \"m\"", &["scene.parts[0]", "mesh"]),
        ("[[scene.parts]]\nmesh = \"\"", &["`scene.parts[0].mesh`", "empty"]),
        (
            "[scene]\nunit = \"m\"\n[[scene.parts]]\nmesh = \"a.obj\"",
            &["2:1", "`scene.unit`", "[[scene.parts]]"],
        ),
        ("[scene]\nmesh = \"b.obj\"\n[[scene.parts]]\nmesh = \"a.obj\"", &["2:1", "`scene.mesh`", "parts"]),
        ("[[scene.parts]]\nmesh = \"a.obj\"\nscale = -1", &["3:1", "`scene.parts[0].scale`", "-1"]),
        ("[[scene.parts]]\nmesh = \"a.obj\"\nunit = \"m\"\nsize = 1", &["`scene.parts[0].size`", "unit"]),
        (
            "[[scene.parts]]\nmesh = \"a.obj\"\nfit = [0, 0, 1]\ntranslate = [0, 0, 1]",
            &["parts[0].fit", "translate"],
        ),
        (
            "[[scene.parts]]\nmesh = \"a.obj\"\nname = \"x\"\n[[scene.parts]]\nmesh = \"b.obj\"\nname = \"x\"",
            &["6:1", "`scene.parts[1].name`", "`x`"],
        ),
        ("[output]\nformats = [\"exr\", \"exr\"]", &["`output.formats[1]`"]),
        ("[expect]\nrmse = {}", &["`expect.rmse`", "limit"]),
        ("[expect]\ncompleteness = { min = 65 }", &["expect.completeness", "65", "0 to 1"]),
        ("[expect]\nrmse = { min = 2, max = 1 }", &["`expect.rmse`", "2.0", "1.0"]),
        ("[sweep]\nstop = 1e400", &["2:1", "`sweep.stop`", "large"]),
        ("[reflectors]\nseed = 99999999999999999999", &["`reflectors.seed`", "large"]),
        ("[sweep]\nstop 3", &["run.toml:2:", "TOML"]),
        ("[sweep]\nstop = 3\nstop = 4", &["run.toml:3:", "TOML"]),
    ] {
        refused_with(text, parts);
    }
}

#[test]
fn an_override_at_fault_is_named() {
    let text = "[sweep]\nstart = 10000\nstop = 20000\n[[materials]]\nname = \"a\"";
    for (typed, parts) in [
        ("grid.ptich=1", &["`ptich`", "`pitch`"][..]),
        ("gird.pitch=1", &["[gird]", "[grid]"]),
        ("pitch=1", &["`pitch`", "[array]", "[grid]", "table.key=value"]),
        ("nothing", &["table.key=value"]),
        ("sweep..step=1", &["key", "empty"]),
        ("=1", &["key", "empty"]),
        ("sweep.step=20Hz", &["\"20Hz\"", "number"]),
        ("sweep.step=", &["TOML"]),
        ("array.count=[64,", &["TOML"]),
        ("scene.fit=[1..2, .5, 1]", &["TOML"]),
        ("sweep.start=30000", &["20000", "30000"]),
        ("sweep.start.low=3", &["`sweep.start`"]),
        ("materials.7.name=b", &["`materials`", "1"]),
        ("sweep.step=1\nstop=2", &["number"]),
        ("array.count=[1e999, 1]", &["large"]),
    ] {
        let message = read_with(text, &[typed]).expect_err(typed).to_string();
        assert!(message.starts_with("--set "), "{typed}: {message}");
        assert_names(message, parts);
    }
    let both =
        read_with("", &["scene.fit=[0,0,1]", "scene.translate=[0,0,1]"]).expect_err("both").to_string();
    assert!(both.starts_with("--set scene.fit=[0,0,1]: "), "{both}");
}

#[test]
fn files_that_are_no_run_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let missing = RunFile::load(&folder.path().join("none.toml"), &[]).expect_err("missing");
    assert_names(missing.to_string(), &["none.toml", "file"]);
    assert!(RunFile::load(folder.path(), &[]).is_err(), "a folder");
    for (bytes, part) in [(&b"[scene]\nmesh = \"\xff\"\n"[..], "UTF-8"), (&vec![b' '; 2 << 20][..], "1 MiB")]
    {
        let path = folder.path().join("bad.toml");
        std::fs::write(&path, bytes).unwrap();
        let error = RunFile::load(&path, &[]).expect_err(part);
        assert_eq!(error.exit_status(), 2);
        assert_names(error.to_string(), &["bad.toml", part]);
    }
}

#[test]
fn speakers_that_do_not_fit_the_geometry_are_refused() {
    let array = |keys: &str| format!("[array]\n{keys}");
    let both = array("source = [0.1, 0, 0]\nsources = [[0, 0, 0]]");
    refused_with(
        &both,
        &["`array.sources`", "both say", "leave `array.sources` out", "change `array.source`"],
    );
    refused_with(&array("sources = []"), &["`array.sources`", "0 speakers", "1 to"]);
    refused_with(&array("sources = [[0, 0]]"), &["`array.sources", "list of 2", "list of 3"]);
    refused_with(&array("sources = [[0, 0, 1e10]]"), &["`array.sources`", "10000000000", "1e9 m"]);
    let scan = array("geometry = \"monostatic\"\nsources = [[0, 0, 0], [1, 0, 0]]");
    refused_with(&scan, &["`array.sources`", "scan"]);
    refused_with(&array("geometry = \"pair\""), &["`array.geometry`", "`source_offset`"]);
    refused_with(&array("source_offset = [0.1, 0, 0]"), &["`array.source_offset`", "geometry = \"pair\""]);
    let file = array("source_file = \"speakers.csv\"");
    refused_with(&file, &["`array.source_file`", "geometry = \"pair\""]);
    let two = array("geometry = \"pair\"\nsource_offset = [0.1, 0, 0]\nsource_file = \"speakers.csv\"");
    refused_with(
        &two,
        &["`array.source_offset`", "both say", "leave `array.source_offset` out", "`array.source_file`"],
    );
    let placed = array("geometry = \"pair\"\nsource_offset = [0.1, 0, 0]\nsource = [1, 0, 0]");
    refused_with(&placed, &["`array.source`", "scan"]);
}

#[test]
fn what_bounces_cannot_be_simulated_with_is_refused() {
    let with = |keys: &str| format!("[scene]\nbounces = 1\n{keys}");
    refused_with("[scene]\nbounces = 3", &["2:1", "`scene.bounces`", "3", "0, 1 or 2"]);
    refused_with("[scene]\nbounces = -1", &["scene.bounces", "-1"]);
    refused_with("[scene]\nbounces = 0.5", &["scene.bounces", "0.5"]);
    refused_with(&with("mesh = \"points.csv\""), &["`scene.bounces`", "list of reflectors"]);
    refused_with(&with("[reflectors]\nsurface = \"smooth\""), &["`scene.bounces`", "rough"]);
    refused_with(&with("[reflectors]\nshading = \"none\""), &["`scene.bounces`", "lambert"]);
    refused_with(&with("[array]\ngeometry = \"monostatic\""), &["`scene.bounces`", "scan"]);
    refused_with(&with("[array]\nspeaker_radius = 0.01"), &["`scene.bounces`", "radiates"]);
    refused_with(&with("[detection]\nmodel = \"linear\""), &["`scene.bounces`", "exact"]);
    let interface = "[medium]\ninterface = { depth = 0.02, sound_speed = 5900.0 }";
    refused_with(&with(interface), &["`scene.bounces`", "one medium"]);
    let edges = "[scene]\nedges = true\n[array]\ngeometry = \"monostatic\"";
    refused_with(edges, &["`scene.edges`", "edges need a speaker that stays"]);
    refused_with("[scene]\nedges = 1", &["scene.edges", "boolean"]);
    let moving = "velocity = [0, 0, 0.1]\n[recording]\ndwell = 0.02";
    assert!(read_with(&with(moving), &[]).expect("as one").scene.velocity.is_some());
    let apart =
        "[[scene.parts]]\nmesh = \"a.obj\"\nname = \"a\"\nvelocity = [0, 0, 0.1]\n[recording]\ndwell = 0.02";
    refused_with(&with(apart), &["`scene.parts[0].velocity`", "scene.bounces", "alike"]);
    refused_with(&format!("[scene]\nedges = true\n{apart}"), &["scene.parts[0].velocity", "scene.edges"]);
    let several = "[array]\nsources = [[0, 0, 0], [0.1, 0, 0]]\n[reflectors]\nsurface = \"rough\"";
    assert_eq!(read_with(&with(several), &[]).expect("possible").scene.bounces, 1);
}

#[test]
fn recordings_that_cannot_be_are_refused() {
    refused_with("[recording]\nsignal = \"chirp\"", &["recording.signal", "\"tones\", \"broadband\""]);
    refused_with(
        "[recording]\nformat = \"int32\"",
        &["recording.format", "\"int16\", \"int24\", \"float32\""],
    );
    refused_with("[recording]\nreference = 1.5", &["`reference`", "counted from 0", "file"]);
    refused_with("[recording]\nreference = \"\"", &["`recording.reference`", "empty"]);
    refused_with("[recording]\nlatency = \"soon\"", &["`latency`", "time in s", "direct"]);
    refused_with("[recording]\nlatency = 1e9", &["`recording.latency`", "1000000000.0", "direct"]);
    refused_with("[recording]\nmicrophones = [1, 2, 1]", &["`recording.microphones`", "twice"]);
    refused_with("[recording]\nmicrophones = [-1]", &["recording.microphones", "-1"]);
    refused_with("[recording]\ndwell = 0", &["`recording.dwell`", "0.05"]);
    refused_with(
        "[recording]\ndwell = 0.05\nsettling = 0.05",
        &["run.toml:3:1", "`recording.settling`", "0.05", "something is left"],
    );
    refused_with("[recording]\nstart = -1", &["`recording.start`", "0 or more"]);
    refused_with("[recording]\nsample_rate = 0", &["`recording.sample_rate`", "48000"]);
    refused_with("[recording]\ndecay = inf", &["`recording.decay`"]);
}

#[test]
fn instruments_that_cannot_be_are_refused() {
    let of = |keys: &str| format!("[instrument]\n{keys}");
    refused_with(&of("mixer = \"diode\""), &["instrument.mixer", "\"sine\", \"switch\""]);
    refused_with(&of("quadrature = \"both\""), &["instrument.quadrature", "\"mixers\", \"passes\""]);
    refused_with(&of("filter = \"rc\""), &["\"ideal\", \"integration\", \"low-pass\""]);
    refused_with(&of("amplifier_band = [2e4, 100.0]"), &["`instrument.amplifier_band`", "20000.0", "100.0"]);
    refused_with(&of("microphone_band = [-1.0, 100.0]"), &["`instrument.microphone_band`", "-1.0"]);
    refused_with(&of("harmonics_db = [3.0]"), &["`instrument.harmonics_db`", "3.0", "-300 to 0 dB"]);
    refused_with(&of("quadrature_error = 100.0"), &["`instrument.quadrature_error`", "90"]);
    refused_with(&of("low_pass = 10.0"), &["`instrument.low_pass`", "low-pass"]);
    refused_with(&of("decay = 0.01"), &["`instrument.decay`", "integration"]);
    refused_with(&of("filter = \"integration\""), &["run.toml:2:1", "`instrument.filter`", "dwell"]);
    refused_with(&of("clock_drift = 1.0"), &["`instrument.clock_drift`", "dwell"]);
    refused_with(&of("clock_error = 1e9"), &["`instrument.clock_error`", "per million"]);
    refused_with(&of("jitter = -1.0"), &["`instrument.jitter`", "1e-7"]);
    refused_with(&of("adc_bits = 40"), &["`instrument.adc_bits`", "40", "24"]);
    refused_with(&of("adc_full_scale = 0.0"), &["`instrument.adc_full_scale`", "greater than 0"]);
}
