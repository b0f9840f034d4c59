// A page of which a file did not load is dead, and cannot say so: load it again.
// Browsers end all requests when the network of the computer changes, e.g. from Wi-Fi to a cable, or when Docker adds an interface.
"use strict";

(() => {
  const KEY = "phm-loads";
  const FIRST_MS = 500;
  const LONGEST_MS = 8000;
  let again = false;

  addEventListener(
    "error",
    (event) => {
      const file = event.target;
      if (again || !(file instanceof HTMLScriptElement || (file instanceof HTMLLinkElement && file.rel === "stylesheet"))) return;
      again = true;
      const failed = Number(sessionStorage.getItem(KEY)) || 0;
      sessionStorage.setItem(KEY, String(failed + 1));
      setTimeout(() => location.reload(), Math.min(FIRST_MS * 2 ** Math.min(failed, 10), LONGEST_MS));
    },
    true,
  );
  addEventListener("load", () => !again && sessionStorage.removeItem(KEY));
})();
