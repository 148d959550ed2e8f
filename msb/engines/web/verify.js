"use strict";
// This script is added to a page for a measurement (dedicated_page/measurement.py).
// The script draws the test views that the server requests.
(async () => {
  const answer = async (head, ...parts) =>
    fetch("answer", { method: "POST", body: new Blob([JSON.stringify(head), "\n", ...parts]) });
  await ready;
  if (!native) { await answer({ error: byId("note").textContent || byId("message").textContent }); return; }
  await answer({ browser: navigator.userAgent, device: native.name, format: native.format });
  for (;;) {
    let task;
    // Without a server the page closes its window, which ends the browser.
    try { task = await (await fetch("next")).json(); } catch { window.close(); return; }
    try {
      const start = performance.now(), bytes = await pixelsOf(task.test);
      await answer({ ms: performance.now() - start }, bytes);
    } catch (error) { await answer({ error: String(error.message || error) }); }
  }
})();
