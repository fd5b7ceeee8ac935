//! What is refused, where it says the fault is, and in which words.

use super::*;

#[test]
fn unknown_names_come_with_the_nearest_and_their_place() {
    refused_with(
        "[grid]\n\n  ptich = [1, 1, 1]",
        &[
            "run.toml:3:3, key `grid.ptich`: ",
            "unknown key `ptich` in [grid]; did you mean `pitch`? (Keys here: x, y",
        ],
    );
    refused_with(
        "[swep]\nstep = 1",
        &["run.toml:1:2", "unknown table [swep]; did you mean [sweep]?", "medium"],
    );
    refused_with("[[material]]\nname = 'a'", &["unknown table [material]; did you mean [materials]?"]);
    refused_with(
        "step = 20",
        &["run.toml:1:1", "unknown key `step` outside every table; it belongs in [sweep]"],
    );
    refused_with("[sweep]\nmedian = 3", &["unknown key `median` in [sweep]; it belongs in [depth]."]);
    refused_with("[array]\ncenter = [0,0,0]", &["did you mean `centre`?"]);
    refused_with(
        "[depth]\npick = \"strongst\"",
        &["did you mean \"strongest\"?", "accepted: \"strongest\", \"first\""],
    );
    refused_with(
        "[expect]\ncompletness = { min = 0.5 }",
        &["unknown metric", "did you mean `completeness`?"],
    );
    refused_with("[expect]\nrmse = { mx = 0.5 }", &["key `expect.rmse.mx`", "did you mean `max`?"]);
    refused_with(
        "[[materials]]\nname = 'a'\n[[materials]]\nname = 'b'\nreflectence = 1",
        &["run.toml:5:1, key `materials[1].reflectence`", "did you mean `reflectance`?"],
    );
}

#[test]
fn views_and_limits_that_mean_nothing_are_refused() {
    refused_with("[depth]\nfov = 50.0", &["run.toml:2:1", "depth.fov", "view = \"perspective\""]);
    refused_with("[depth]\npixels = [64, 48]", &["depth.pixels", "view = \"perspective\""]);
    let camera = |key: &str| format!("[depth]\nview = \"perspective\"\n{key}");
    refused_with(&camera("fov = 180.0"), &["run.toml:3:1", "between 0 and 180"]);
    refused_with(&camera("pixels = [64, 0]"), &["depth.pixels", "at least 1"]);
    refused_with("[depth]\nreturn_contrast_db = -3.0", &["depth.return_contrast_db", "60 dB"]);
    refused_with("[expect]\nseeds = [1, 2, 1]", &["expect.seeds", "1 twice"]);
    refused_with("[expect]\nseeds = 3", &["expect.seeds", "a list"]);
    refused_with(
        "[expect]\n\"completness:glass\" = { min = 0.5 }",
        &["unknown metric `completness`", "did you mean `completeness`?", "NAME:MATERIAL"],
    );
    refused_with("[expect]\n\"completeness#0\" = { min = 0.5 }", &["unknown metric `completeness#0`"]);
    refused_with("[expect]\n\"two_returns:glass\" = { min = 90 }", &["a share from 0 to 1"]);
}

#[test]
fn what_this_version_lacks_is_refused_with_what_it_has() {
    refused_with(
        "[reconstruct]\nmethod = \"holographic\"",
        &["accepted: \"auto\", \"convolution\", \"backprojection\", \"direct\", \"linear\""],
    );
    refused_with("[array]\nlayout = \"ring\"", &["accepted: \"grid\", \"spiral\", \"random\", \"file\""]);
    refused_with("[depth]\nview = \"isometric\"", &["accepted: \"orthographic\", \"perspective\""]);
    refused_with(
        "[output]\nformats = [\"exr\", \"vdb\"]",
        &["formats[1]", "accepted: \"exr\", \"npz\", \"vti\", \"nrrd\""],
    );
}

#[test]
fn wrong_types_are_named_in_plain_words() {
    refused_with(
        "[sweep]\nstep = \"20\"",
        &["2:1, key `sweep.step`", "the text \"20\"", "leave the quotes out"],
    );
    refused_with("[sweep]\nstep = true", &["found true; expected a number"]);
    refused_with("[sweep]\nstep = nan", &["NaN", "expected a finite number"]);
    refused_with("[grid]\npitch = 0.01", &["expected a list of 3 numbers, such as [0.0, 0.0, 0.0]"]);
    refused_with("[grid]\npitch = [0.01, 0.01]", &["found a list of 2 values; expected a list of 3 numbers"]);
    refused_with("[grid]\npitch = [0.01,\n 0.01,\n \"a\"]", &["run.toml:4:2, key `grid.pitch[2]`"]);
    refused_with("[grid]\nx = [0, 1, 2]", &["list of length 3; expected [first, last] in metres"]);
    refused_with("[grid]\nx = \"a\"", &["the text \"a\"; expected [first, last] in metres"]);
    refused_with("[array]\ncount = [3.5, 4]", &["the number 3.5; expected a whole number"]);
    refused_with("[array]\ncount = [-3, 4]", &["the number -3; expected a whole number from 0"]);
    refused_with("[scene]\nmesh = 3", &["expected text in quotes"]);
    refused_with("[scene]\nunit = 3", &["expected one of \"m\", \"cm\", \"mm\", \"in\", \"ft\""]);
    refused_with("scene = 3", &["run.toml:1:1, key `scene`", "expected a table with the keys mesh, unit"]);
    refused_with(
        "[materials]\nname = \"a\"",
        &["found a table; expected a list: write [[materials]] in double"],
    );
    refused_with("[[materials]]\nreflectance = 1", &["the key `name` is missing"]);
    refused_with("[expect]\nrmse = 0.5", &["the number 0.5; expected a table with the keys min, max"]);
    refused_with("[depth]\nfill = \"zero\"", &["the text \"zero\"; expected \"inf\", \"nan\" or a number"]);
    refused_with("[sweep]\nstep = 1979-05-27", &["a date"]);
}

#[test]
fn values_outside_their_range_are_refused_at_their_line() {
    for (text, parts) in [
        ("[sweep]\nstart = 10\nstop = 20\nstep = 0", &["4:1, key `sweep.step`", "greater than 0"][..]),
        ("[sweep]\nstart = 30000", &["run.toml:1:2, key `sweep.stop`", "before its start"]),
        ("[sweep]\nstep = 30", &["333.3333 steps of 30", "stop = 19990", "step = 30.0"]),
        ("[sweep]\nstep = 30000", &["step = 10000.0"]),
        ("[sweep]\nstep = 1e-9", &["too many"]),
        ("[[materials]]\nname = 'a'\nreflectance = 1.5", &["`materials[0].reflectance`", "from 0 to 1"]),
        ("[[materials]]\nname = 'a'\ntransmittance = -1", &["`materials[0].transmittance`"]),
        ("[[materials]]\nname = ''", &["\"*\" matches every name"]),
        ("[grid]\nz = [-1, 1]", &["lies behind the array"]),
        ("[grid]\nx = [1, -1]", &["lies before the first"]),
        ("[grid]\npitch = [0, 1, 1]", &["greater than 0"]),
        ("[grid]\nx = [0, 1e300]\npitch = [1e-9, 1, 1]", &["too many"]),
        ("[medium]\nsound_speed = -343", &["greater than 0"]),
        ("[medium]\ntemperature = 500", &["degrees Celsius from -50 to 60"]),
        ("[medium]\ntemperature = 20\nhumidity = 101", &["0 to 100 %"]),
        ("[medium]\ntemperature = 20\npressure = 101", &["1e4 to 1e6 Pa"]),
        ("[medium]\ntemperature = 60\nhumidity = 100\npressure = 2e4", &["would be water"]),
        ("[medium]\nhumidity = 40", &["`medium.humidity`", "give `temperature`"]),
        ("[medium]\nabsorption = true", &["`medium.absorption`", "give `temperature`"]),
        ("[medium]\nsound_speed = 340\ntemperature = 20", &["`medium.temperature`", "keep one of the two"]),
        ("[array]\nspeaker_radius = -1", &["0 or more"]),
        ("[array]\nphase_error = 400", &["0 to 360 degrees"]),
        ("[reflectors]\nspacing = 0", &["greater than 0"]),
        ("[reflectors]\nroughness = -1", &["0 or more"]),
        ("[depth]\nreturns = 0", &["1 to 16"]),
        ("[depth]\nreturns = 17", &["1 to 16"]),
        ("[depth]\nmedian = 4", &["odd"]),
        ("[depth]\nmedian = 0", &["odd"]),
        ("[depth]\nseparation = 0", &["greater than 0"]),
        ("[depth]\nsmoothing = [0, -1, 0]", &["0 or more"]),
        ("[depth]\nthreshold_db = 14", &["0 dB or less"]),
        ("[depth]\nfill = -inf", &["number of metres"]),
        ("[reconstruct]\ntolerance = 1", &["relative error"]),
        ("[detection]\ntolerance = -1e-6", &["detection.tolerance", "relative error"]),
        ("[array]\ncount = [0, 1]", &["at least 1"]),
        ("[array]\ncount = [4000000000, 4000000000]", &["too many"]),
        ("[array]\ncount = [1, 1]\nextent = [1, 0]", &["1 microphones cannot span"]),
        ("[array]\ngeometry = \"monostatic\"\nsource = [0, 0, 1]", &["no speaker of its own"]),
        ("[array]\nlayout = \"file\"", &["needs the key `file`"]),
        ("[array]\nfile = \"a.csv\"", &["needs `layout = \"file\"`"]),
        ("[array]\nlayout = \"file\"\nfile = \"a.csv\"\ncount = [2, 2]", &["4:1", "the file's own"]),
        ("[array]\nelements = 200", &["no square grid", "such as 196"]),
        ("[array]\nelements = 0", &["array.elements", "at least 1"]),
        ("[array]\nelements = 256\ncount = [16, 16]", &["keep one of the two"]),
        ("[array]\nlayout = \"spiral\"\nseed = 2", &["3:1", "needs `layout = \"random\"`"]),
        ("[array]\nspacing = 0.01", &["2:1", "needs `layout = \"random\"`"]),
        ("[array]\nlayout = \"random\"\nspacing = -1", &["0 or more"]),
        ("[array]\nlayout = \"random\"\nfile = \"a.csv\"", &["needs `layout = \"file\"`"]),
        ("[array]\nextent = [1, 1, 1]", &["expected [along x, along y], or one number for both"]),
        ("[array]\ncount = 3.5", &["the number 3.5"]),
        ("[array]\npitch = [1, 1]\nextent = [1, 1]", &["3:1, key `array.extent`", "keep one"]),
        ("[scene]\nfit = [0, 0, 1]\ntranslate = [0, 0, 1]", &["2:1, key `scene.fit`", "keep one"]),
        ("[scene]\nfit = [0, 0, 1]\nsensor = \"node:a\"", &["keep one"]),
        ("[scene]\nsensor = \"Front\"", &["camera:NAME"]),
        ("[scene]\nsensor = \"camera:\"", &["camera:NAME"]),
        ("[scene]\nscale = 0", &["greater than 0"]),
        ("[scene]\nmesh = \"\"", &["is empty"]),
        ("[output]\nformats = [\"exr\", \"exr\"]", &["second time"]),
        ("[expect]\nrmse = {}", &["sets no limit"]),
        ("[expect]\ncompleteness = { min = 65 }", &["share from 0 to 1"]),
        ("[expect]\nrmse = { min = 2, max = 1 }", &["at least 2.0 and at most 1.0"]),
        ("[sweep]\nstop = 1e400", &["2:1, key `sweep.stop`", "too large"]),
        ("[reflectors]\nseed = 99999999999999999999", &["too large"]),
        ("[sweep]\nstop 3", &["run.toml:2:", "is not valid TOML"]),
        ("[sweep]\nstop = 3\nstop = 4", &["run.toml:3:", "is not valid TOML"]),
    ] {
        refused_with(text, parts);
    }
}

#[test]
fn an_override_at_fault_is_named() {
    let text = "[sweep]\nstart = 10000\nstop = 20000\n[[materials]]\nname = \"a\"";
    for (typed, part) in [
        ("grid.ptich=1", "did you mean `pitch`?"),
        ("gird.pitch=1", "did you mean [grid]?"),
        ("pitch=1", "`pitch` lacks its table ([array] or [grid]); write table.key=value"),
        ("nothing", "expected table.key=value"),
        ("sweep..step=1", "a part of the key is empty"),
        ("=1", "a part of the key is empty"),
        ("sweep.step=20Hz", "the text \"20Hz\"; expected a number"),
        ("sweep.step=", "not valid TOML"),
        ("array.count=[64,", "not valid TOML"),
        ("sweep.start=30000", "before its start"),
        ("sweep.start.low=3", "`sweep.start` is a value"),
        ("materials.7.name=b", "`materials` is a list of 1"),
        ("sweep.step=1\nstop=2", "expected a number"),
        ("array.count=[1e999, 1]", "too large"),
    ] {
        let message = read_with(text, &[typed]).expect_err(typed).to_string();
        assert!(message.starts_with("--set ") && message.contains(part), "{typed}: {message}");
    }
    let both =
        read_with("", &["scene.fit=[0,0,1]", "scene.translate=[0,0,1]"]).expect_err("both").to_string();
    assert!(both.starts_with("--set scene.fit=[0,0,1]: "), "{both}");
}

#[test]
fn files_that_are_no_run_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let missing = RunFile::load(&folder.path().join("none.toml"), &[]).expect_err("missing");
    assert!(missing.to_string().contains("no such file"), "{missing}");
    assert!(RunFile::load(folder.path(), &[]).is_err(), "a folder");
    for (bytes, part) in [
        (&b"[scene]\nmesh = \"\xff\"\n"[..], "is not UTF-8"),
        (&vec![b' '; 2 << 20][..], "larger than 1 MiB"),
    ] {
        let path = folder.path().join("bad.toml");
        std::fs::write(&path, bytes).unwrap();
        let error = RunFile::load(&path, &[]).expect_err(part);
        assert!(error.to_string().contains(part) && error.exit_status() == 2, "{error}");
    }
}
